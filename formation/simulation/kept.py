"""Machine code that is kept for the next process: in a folder of the user's own, another for other sources.

numba by itself looks only at the file of the function that it compiles, not at those of what that calls; it
reads whatever it finds, though what it reads can run anything; and it gives up where a file is damaged.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba import config
from numba.core.caching import FunctionCache

FORGOTTEN = 30.0 * 24.0 * 3600.0
"""Machine code that nobody has used for so long is deleted [s]."""
_PACKAGE = Path(__file__).resolve().parents[1]


def keep(dispatcher: Any) -> None:
    """Have the machine code of a compiled function kept, where there is room for it."""
    with suppress(RuntimeError):  # numba's word for a folder that lets nobody write
        if not _is_kept():
            return
        # as its `enable_caching` does
        dispatcher._cache = _Kept(dispatcher.py_func)  # type: ignore[no-untyped-call] # noqa: SLF001


class _Kept(FunctionCache):
    """What cannot be read is compiled anew, what cannot be written is not kept."""

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
def _is_kept() -> bool:
    digest = hashlib.sha256(sys.version.encode())
    for source in sorted(_PACKAGE.rglob("*.py")):
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
    except (OSError, RuntimeError):  # nowhere to write to, or nobody's home
        return False
    _forget_others(folder)
    config.CACHE_DIR = str(folder)  # type: ignore[attr-defined] # made when numba is loaded
    return os.access(folder, os.W_OK)


def _is_mine_alone(folder: Path) -> bool:
    """Whether nobody else can have put anything into it."""
    found = folder.stat()
    return found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _forget_others(folder: Path) -> None:
    long_ago = folder.stat().st_mtime - FORGOTTEN
    for other in folder.parent.iterdir():
        if re.fullmatch("[0-9a-f]{16}", other.name):  # the rest is not ours
            with suppress(OSError):  # another process may be faster
                if other.stat().st_mtime < long_ago:
                    shutil.rmtree(other)
