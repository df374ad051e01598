"""The stopwatches sit where an agent as it is today has its seams."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_the_profiled_agent_takes_what_an_agent_takes(tmp_path: Path) -> None:
    command = (
        sys.executable,
        "-m",
        "tests.campaigns.bench.profiled_agent",
        str(tmp_path / "profile.json"),
        "--help",
    )
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "--robot" in done.stdout
