"""A cache of compiled code for later processes, in a folder of the user, one for each version of its sources.

Only the packages in `SOURCES` count as these, so that a change elsewhere compiles nothing again. numba's own
cache checks only the file of the compiled function, not those of the functions it calls; it reads any file
it finds, though such a file can run anything; and it fails if a file is damaged.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import sys
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba import config
from numba.core.caching import FunctionCache

MAX_UNUSED_TIME = 30.0 * 24.0 * 3600.0
"""Time without use after which compiled code is deleted [s]."""
SOURCES = ("control", "mission", "simulation")
"""Packages of `formation` from which cached code may use functions and numbers."""
_PACKAGE = Path(__file__).resolve().parents[1]


def cache_code(dispatcher: Any, modules: Iterable[str]) -> None:
    """Cache the machine code of a function compiled from `modules` of `SOURCES`, if there is room."""
    if not all(name.startswith(tuple(f"formation.{one}." for one in SOURCES)) for name in modules):
        return
    with suppress(RuntimeError):  # numba's error for a folder that is not writable
        if not _can_cache():
            return
        # as its `enable_caching` does
        dispatcher._cache = _Cache(dispatcher.py_func)  # type: ignore[no-untyped-call] # noqa: SLF001


class _Cache(FunctionCache):
    """Compiles again what cannot be read, and ignores what cannot be written."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # noqa: BLE001 - a damaged pickle may raise anything
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):  # a full disk, or still the damaged file
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


@cache
def _can_cache() -> bool:
    digest = hashlib.sha256(sys.version.encode())
    for source in sorted(path for one in SOURCES for path in (_PACKAGE / one).rglob("*.py")):
        digest.update(source.read_bytes())
    try:
        caches = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
        home = Path(caches or Path.home() / ".cache") / "formation"
        home.mkdir(parents=True, exist_ok=True)
        folder = home / digest.hexdigest()[:16]
        folder.mkdir(mode=0o700, exist_ok=True)
        if not _is_mine_alone(folder):
            return False
        os.utime(folder)
    except (OSError, RuntimeError):  # no writable folder, or no home directory
        return False
    _forget_others(folder)
    config.CACHE_DIR = str(folder)  # type: ignore[attr-defined] # made when numba is loaded
    return os.access(folder, os.W_OK)


def _is_mine_alone(folder: Path) -> bool:
    """Whether only this user can have written into it."""
    found = folder.stat()
    return found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _forget_others(folder: Path) -> None:
    long_ago = folder.stat().st_mtime - MAX_UNUSED_TIME
    for other in folder.parent.iterdir():
        if re.fullmatch("[0-9a-f]{16}", other.name):  # other files do not belong to this cache
            with suppress(OSError):  # another process may delete it first
                if other.stat().st_mtime < long_ago:
                    shutil.rmtree(other)
