"""Pure functions of numbers, compiled as they stand, with all that they call.

The law, the observer and the tracks are written once, in plain Python, for robots to run. Here numba makes
machine code of the same source for whoever simulates many of them. Where numba is not installed (it is in
``formation[desk]``) the same functions run as they are, some hundred times slower.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, TypeVar

AVAILABLE = importlib.util.find_spec("numba") is not None
"""Whether there is something to compile with."""
FORGOTTEN = 30.0 * 24.0 * 3600.0
"""Machine code that nobody has used for so long is deleted [s]."""
_PACKAGE = Path(__file__).resolve().parents[1]
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function, **instead: Callable[..., Any]) -> _Function:
    """Machine code of `function` and of every Python function that it names; made at its first call.

    What is given by name is taken `instead` of what has that name where it is used.
    """
    made: _Function = _made(function, tuple(sorted(instead.items())), outermost=True)
    return made


def magnitude(value: complex) -> float:
    """|value|, in a third of the time that `abs` takes, which minds squares beyond 1e308."""
    return math.fabs(value.real) if value.imag == 0.0 else math.sqrt(value.real**2 + value.imag**2)


@cache
def _made(function: Any, instead: tuple[tuple[str, Callable[..., Any]], ...], *, outermost: bool) -> Any:
    known = {**function.__globals__, "abs": magnitude if AVAILABLE else abs, **dict(instead)}
    for name in _names(function.__code__):
        if isinstance(known.get(name), FunctionType):
            known[name] = _made(known[name], instead, outermost=False)
    own = FunctionType(function.__code__, known, function.__name__, function.__defaults__)
    # numba keeps machine code under this name.
    own.__qualname__ = "_".join([function.__qualname__, *(one.__qualname__ for _, one in instead)])
    own.__module__ = function.__module__
    if not AVAILABLE:
        return own
    from numba import njit  # noqa: PLC0415 - takes half a second, and a robot does not have it

    ours = all(one.__module__.startswith("formation.") for one in (function, *(one for _, one in instead)))
    kept = outermost and ours and _is_kept()
    return njit(own, cache=kept, error_model="numpy", forceinline=not outermost)


def _names(code: CodeType) -> set[str]:
    inner = [one for one in code.co_consts if isinstance(one, CodeType)]
    return set(code.co_names).union(*map(_names, inner))


@cache
def _is_kept() -> bool:
    """Whether machine code is kept for the next process, in a folder that is another once a source changes.

    numba by itself looks only at the file of the function that it compiles, not at those of what that calls.
    """
    from numba import config  # noqa: PLC0415

    digest = hashlib.sha256(sys.version.encode())
    for source in sorted(_PACKAGE.rglob("*.py")):
        digest.update(source.read_bytes())
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = Path(os.environ.get("NUMBA_CACHE_DIR") or home / "formation") / digest.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        _forget_others(folder)
    except (OSError, RuntimeError):  # nowhere to write to, or nobody's home
        return False
    config.CACHE_DIR = str(folder)  # type: ignore[attr-defined] # made when numba is loaded
    return os.access(folder, os.W_OK)


def _forget_others(folder: Path) -> None:
    now = folder.stat().st_mtime
    for other in folder.parent.iterdir():
        if other.stat().st_mtime < now - FORGOTTEN:
            shutil.rmtree(other, ignore_errors=True)
