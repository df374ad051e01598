"""Machine code is kept for the next process, in a folder of the user's alone; damage does no harm."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMPILE = """
from formation.control.plane import clip
from formation.simulation.compiled import compiled
made = compiled(clip)
print(made(3.0, 1.0), sum(made.stats.cache_hits.values()))
"""
COMPILED, FOUND = "1.0 0", "1.0 1"


def compiling(**environment: str | Path) -> str:
    """What a process of its own says: a number that was computed, how much machine code it found."""
    given = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    given.update({name: str(value) for name, value in environment.items()})
    command = (sys.executable, "-c", COMPILE)
    return subprocess.run(command, env=given, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()


def folder_in(caches: Path) -> Path:
    (folder,) = (caches / "formation").iterdir()
    return folder


@pytest.mark.parametrize("name", ["XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_the_next_process_finds_what_was_compiled(name: str, tmp_path: Path) -> None:
    assert compiling(**{name: tmp_path}) == COMPILED
    assert compiling(**{name: tmp_path}) == FOUND


def test_where_nothing_can_be_written_all_is_compiled(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert compiling(XDG_CACHE_HOME=tmp_path / "file" / "below") == COMPILED


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_a_damaged_file_is_compiled_anew(ending: str, tmp_path: Path) -> None:
    compiling(XDG_CACHE_HOME=tmp_path)
    for file in tmp_path.rglob(f"*.{ending}"):
        file.write_bytes(file.read_bytes()[:-10])
    assert compiling(XDG_CACHE_HOME=tmp_path) == COMPILED
    assert compiling(XDG_CACHE_HOME=tmp_path) == FOUND


def test_a_folder_that_others_may_write_to_is_not_read(tmp_path: Path) -> None:
    compiling(XDG_CACHE_HOME=tmp_path)
    folder_in(tmp_path).chmod(0o777)
    assert compiling(XDG_CACHE_HOME=tmp_path) == COMPILED


@pytest.mark.parametrize("name", ["XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_only_old_machine_code_of_ours_is_forgotten(name: str, tmp_path: Path) -> None:
    old = tmp_path / "formation" / "0123456789abcdef"
    others = [tmp_path / "somebody's", tmp_path / "formation" / "notes", tmp_path / "0123456789abcdef"]
    for folder in (old, *others):
        folder.mkdir(parents=True)
        os.utime(folder, (0.0, 0.0))
    compiling(**{name: tmp_path})
    assert not old.exists()
    assert all(folder.exists() for folder in others)
