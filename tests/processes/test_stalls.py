"""A test that fails during a stall of the machine is run again, and the summary names it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


STALLING = """
import os, subprocess, time

RUNS = []

def test_in_a_stall():
    RUNS.append(1)
    pause = f"sleep 0.1; kill -STOP {os.getpid()}; sleep 0.5; kill -CONT {os.getpid()}"
    with subprocess.Popen(["sh", "-c", pause]) as pausing:
        while pausing.poll() is None:
            time.sleep(0.01)
    assert len(RUNS) == 2

def test_without_a_stall():
    RUNS.append(1)
    assert len(RUNS) > 3
"""
RERUN_HOOKS = """
from tests import conftest
from tests.conftest import pytest_addoption, pytest_runtest_protocol, pytest_terminal_summary

conftest.MIN_STALL_SECONDS = 0.4  # the test's own stall takes longer; one of this machine rarely does
"""


def test_failures_in_stalls_are_run_again_and_named(tmp_path: Path) -> None:
    folder = tmp_path / "tests" / "processes"
    folder.mkdir(parents=True)
    (tmp_path / "conftest.py").write_text(RERUN_HOOKS)
    (folder / "test_stalling.py").write_text(STALLING)
    where = ["--config-file", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path), str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--numprocesses=0", *where],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "RUN AGAIN tests/processes/test_stalling.py::test_in_a_stall: failed while" in done.stdout
    assert "1 failed, 1 passed" in done.stdout
    assert "where 3 = len([1, 1, 1])" in done.stdout  # it ran once; the other test had run twice before
