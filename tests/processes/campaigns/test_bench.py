"""The benchmarks as commands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def bench(*words: str) -> subprocess.CompletedProcess[str]:
    command = (sys.executable, "-m", *words)
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_robotarium_flag_without_peers_prints_one_error() -> None:
    done = bench("tests.campaigns.bench", "batch", "--quick", "--robotarium", "nowhere")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(
        "error: --robotarium needs --peers FOLDER: that is where what it imports is installed"
    )
    assert "Traceback" not in done.stderr


def test_profiled_agent_help_lists_robot_flag(tmp_path: Path) -> None:
    done = bench("tests.campaigns.bench.profiled_agent", str(tmp_path / "profile.json"), "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "--robot" in done.stdout
