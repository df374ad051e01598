"""Subjects are started as a user's are: their modules were compiled before, when they were first used."""

from __future__ import annotations

from collections.abc import Iterable
from compileall import compile_dir
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGES = ("formation", "agent", "leader", "monitor", "deploy", "tests")


@cache
def ready_to_start() -> None:
    """Call this before the first subject is started, and as often as you like."""
    compile_modules(ROOT / name for name in PACKAGES)


def compile_modules(folders: Iterable[Path]) -> None:
    """Compile whatever has changed in these; also where Python is told to keep nothing that it compiles."""
    for folder in folders:
        compile_dir(folder, quiet=1)
