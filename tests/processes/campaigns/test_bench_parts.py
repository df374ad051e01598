"""All benchmarks by one command: what a part refuses is told in the part's own words."""

from __future__ import annotations

import subprocess
import sys


def test_a_peer_that_is_not_there_is_one_clear_error() -> None:
    command = (sys.executable, "-m", "tests.campaigns.bench", "batch", "--quick", "--robotarium", "nowhere")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(
        "error: --robotarium needs --peers FOLDER: that is where what it imports is installed"
    )
    assert "Traceback" not in done.stderr
