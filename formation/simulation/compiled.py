"""Pure functions of numbers, compiled as they stand, with all that they call.

The law, the observer and the tracks are written once, in plain Python, for robots to run. Here numba makes
machine code of the same source for whoever simulates many of them. Where numba is not installed (it is in
``formation[desk]``) the same functions run as they are, some hundred times slower.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from functools import cache
from types import CodeType, FunctionType
from typing import Any, TypeVar

AVAILABLE = importlib.util.find_spec("numba") is not None
"""Whether there is something to compile with."""
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

    from formation.simulation.kept import keep  # noqa: PLC0415 - it loads numba too

    made = njit(own, error_model="numpy", forceinline=not outermost)
    parts = (function, *(one for _, one in instead))
    if outermost and all(one.__module__.startswith("formation.") for one in parts):
        keep(made)
    return made


def _names(code: CodeType) -> set[str]:
    inner = [one for one in code.co_consts if isinstance(one, CodeType)]
    return set(code.co_names).union(*map(_names, inner))
