"""A test that a machine cannot run is left out by name, or fails where all have to run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import needs

ROOT = Path(__file__).parents[2]
HOOKS = """
from tests.conftest import pytest_addoption, pytest_configure
from tests.conftest import pytest_collection_modifyitems, pytest_runtest_setup
from tests.support import needs
"""
BLIND = HOOKS + "needs.find = lambda program: None\n"
SEEING = HOOKS + "needs.find = lambda program: '/bin/true'\n"
WANTING = "import pytest\n" + "".join(
    f"""
@pytest.mark.{mark}
def test_that_wants_{mark}() -> None:
    raise AssertionError("{mark} ran")
"""
    for mark in needs.PROGRAMS
)


def run(hooks: str, folder: Path, *, every: bool) -> str:
    """What pytest says of one test for each mark, which fail if they run."""
    (folder / "conftest.py").write_text(hooks)
    (folder / "test_wanting.py").write_text(WANTING)
    where = ["--config-file", str(ROOT / "pyproject.toml"), "--rootdir", str(folder), str(folder)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--numprocesses=0", *where],
        cwd=ROOT,
        env={**os.environ, "FORMATION_TEST_ALL": "1" if every else ""},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def test_without_its_programs_a_test_is_left_out_by_name(tmp_path: Path) -> None:
    result = run(BLIND, tmp_path, every=False)
    assert f"{len(needs.PROGRAMS)} skipped" in result
    for mark, (program, *_) in needs.PROGRAMS.items():
        assert f"test_that_wants_{mark} needs {program} (apt install {needs.PACKAGES[program]})" in result


def test_where_every_test_has_to_run_it_fails_instead(tmp_path: Path) -> None:
    result = run(BLIND, tmp_path, every=True)
    assert f"{len(needs.PROGRAMS)} errors" in result
    for mark, (program, *_) in needs.PROGRAMS.items():
        assert f"test_that_wants_{mark} needs {program} (apt" in result
        assert f"{mark} ran" not in result


@pytest.mark.parametrize("every", [True, False])
def test_with_its_programs_it_runs(tmp_path: Path, every: bool) -> None:
    result = run(SEEING, tmp_path, every=every)
    assert "systemd ran" in result
    assert "ssh ran" in result


def test_every_program_is_in_a_package() -> None:
    assert {name for names in needs.PROGRAMS.values() for name in names} == set(needs.PACKAGES)


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
RERUN_HOOKS = (
    "from tests.conftest import pytest_addoption, pytest_runtest_protocol, pytest_terminal_summary\n"
)


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
    assert "where 3 = len([1, 1, 1])" in done.stdout  # it ran once, after two runs of the other
