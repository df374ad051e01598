"""A test that a machine cannot run is left out by name, or fails where all have to run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import needs

ROOT = Path(__file__).parents[1]
HOOKS = """
from tests import needs
from tests.conftest import pytest_collection_modifyitems, pytest_runtest_setup
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
        [sys.executable, "-m", "pytest", *where],
        cwd=ROOT,
        env={**os.environ, "FORMATION_TEST_ALL": "1" if every else ""},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def test_without_its_programs_a_test_is_left_out_by_name(tmp_path: Path) -> None:
    said = run(BLIND, tmp_path, every=False)
    assert f"{len(needs.PROGRAMS)} skipped" in said
    for mark, (program, *_) in needs.PROGRAMS.items():
        assert f"test_that_wants_{mark} needs {program} (apt install {needs.PACKAGES[program]})" in said


def test_where_every_test_has_to_run_it_fails_instead(tmp_path: Path) -> None:
    said = run(BLIND, tmp_path, every=True)
    assert f"{len(needs.PROGRAMS)} errors" in said
    for mark, (program, *_) in needs.PROGRAMS.items():
        assert f"test_that_wants_{mark} needs {program} (apt" in said
        assert f"{mark} ran" not in said


@pytest.mark.parametrize("every", [True, False])
def test_with_its_programs_it_runs(tmp_path: Path, every: bool) -> None:
    said = run(SEEING, tmp_path, every=every)
    assert "systemd ran" in said
    assert "ssh ran" in said


def test_every_program_is_in_a_package() -> None:
    assert {name for names in needs.PROGRAMS.values() for name in names} == set(needs.PACKAGES)
