"""Machine code is cached for the next process, in a private folder; damaged files are replaced."""

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
CALLS_OTHERS = """
from formation.simulation.compiled import compiled
def half(value):
    return 0.5 * value
def law(value):
    return half(value)
law.__module__ = "formation.control.plane"
made = compiled(law)
print(made(2.0), sum(made.stats.cache_hits.values()))
"""
COMPILED, FOUND = "1.0 0", "1.0 1"


def compiling(script: str = COMPILE, /, **environment: str | Path) -> str:
    """Compile in a new process; return what it prints: a computed number and its cache hits."""
    given = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    given.update({name: str(value) for name, value in environment.items()})
    command = (sys.executable, "-c", script)
    return subprocess.run(command, env=given, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()


def cache_folder(caches: Path) -> Path:
    (folder,) = (caches / "formation").iterdir()
    return folder


@pytest.mark.parametrize("name", ["XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_next_process_uses_cache_and_old_folders_are_deleted(name: str, tmp_path: Path) -> None:
    old = tmp_path / "formation" / "0123456789abcdef"
    others = [tmp_path / "somebody's", tmp_path / "formation" / "notes", tmp_path / "0123456789abcdef"]
    for folder in (old, *others):
        folder.mkdir(parents=True)
        os.utime(folder, (0.0, 0.0))
    assert compiling(**{name: tmp_path}) == COMPILED
    assert not old.exists()
    assert all(folder.exists() for folder in others)
    assert compiling(**{name: tmp_path}) == FOUND


def test_function_that_calls_other_packages_is_not_cached(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(CALLS_OTHERS)
    found = [compiling("import own", PYTHONPATH=tmp_path, XDG_CACHE_HOME=tmp_path) for _ in range(2)]
    assert found == [COMPILED, COMPILED]


def test_function_is_compiled_without_writable_cache_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert compiling(XDG_CACHE_HOME=tmp_path / "file" / "below") == COMPILED


def test_damaged_cache_and_one_writable_by_others_are_replaced(tmp_path: Path) -> None:
    compiling(XDG_CACHE_HOME=tmp_path)
    for ending in ("nbi", "nbc"):
        for file in tmp_path.rglob(f"*.{ending}"):
            file.write_bytes(file.read_bytes()[:-10])
        assert compiling(XDG_CACHE_HOME=tmp_path) == COMPILED, ending
    assert compiling(XDG_CACHE_HOME=tmp_path) == FOUND
    cache_folder(tmp_path).chmod(0o777)
    assert compiling(XDG_CACHE_HOME=tmp_path) == COMPILED
