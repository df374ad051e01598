"""Pure functions of numbers, compiled with all functions that they call.

The law, the observer and the tracks are written once, in plain Python, for robots to run. Here numba
compiles the same source for simulations of many robots. Without numba (the extra `simulate` installs it)
the same functions run uncompiled, over a thousand times slower.
"""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import CodeType, FunctionType
from typing import Any, TypeVar

AVAILABLE = importlib.util.find_spec("numba") is not None
"""Whether a compiler is installed."""
MAX_CAUSE_LETTERS = 300
"""Length of a compiler's message that is passed on."""
_Function = TypeVar("_Function", bound=Callable[..., Any])


class LawError(ValueError):
    """A law cannot be compiled, or raises; the text names the law and the cause."""


@contextmanager
def naming_law(name: str) -> Iterator[None]:
    """Turn errors of the law `name`, and numba's refusal to compile it, into a LawError of one line."""
    try:
        yield
    except Exception as error:
        if not type(error).__module__.startswith("numba."):
            raise LawError(f"the law {name!r} raised {type(error).__name__}: {error}") from error
        lines = str(error).splitlines()
        cause = next((one for one in lines if one.strip() and not one.startswith("Failed in")), "")
        places = (re.search(r'(\w+\.py)", line (\d+)', one) for one in lines)
        place = next((f"{one[1]} line {one[2]}" for one in places if one), "unknown line")
        raise LawError(
            f"the law {name!r} cannot be compiled: {place}: {cause.strip()[:MAX_CAUSE_LETTERS]}; a law takes"
            " six arguments, computes with numbers only, and always returns a Command and the integral"
        ) from None


def compiled(function: _Function, **instead: Callable[..., Any]) -> _Function:
    """Compile `function` and every Python function that it names, at its first call.

    Arguments given by name are used `instead` of the functions of that name.
    """
    compiled_function: _Function = _compiled(function, tuple(sorted(instead.items())), outermost=True)
    return compiled_function


def magnitude(value: complex) -> float:
    """|value|, in a third of the time of `abs`, which also handles squares beyond 1e308."""
    return math.fabs(value.real) if value.imag == 0.0 else math.sqrt(value.real**2 + value.imag**2)


@cache
def _compiled(function: Any, instead: tuple[tuple[str, Callable[..., Any]], ...], *, outermost: bool) -> Any:
    known = {**function.__globals__, "abs": magnitude if AVAILABLE else abs, **dict(instead)}
    for name in _names(function.__code__):
        if isinstance(known.get(name), FunctionType):
            known[name] = _compiled(known[name], instead, outermost=False)
    own = FunctionType(function.__code__, known, function.__name__, function.__defaults__)
    # numba keeps machine code under this name.
    own.__qualname__ = "_".join(
        [function.__qualname__, *(f"{one.__module__}.{one.__qualname__}" for _, one in instead)]
    )
    own.__module__ = function.__module__
    if not AVAILABLE:
        return own
    from numba import njit  # noqa: PLC0415 - takes half a second, and a robot does not have it

    from formation.simulation.machine_code_cache import cache_code  # noqa: PLC0415 - it loads numba too

    # Only Python calls the outermost function, and no Python the others: without the wrappers that numba
    # makes for other callers, compiling takes 30 % less time. Its type hints do not know these options.
    wrappers: Any = {"no_cpython_wrapper": not outermost, "no_cfunc_wrapper": True}
    compiled_function = njit(own, error_model="numpy", forceinline=not outermost, **wrappers)
    if outermost:
        cache_code(compiled_function, _modules(function, instead))
    return compiled_function


@cache
def _modules(function: Any, instead: tuple[tuple[str, Callable[..., Any]], ...]) -> frozenset[str]:
    """The modules of a function and of all functions that it names."""
    known = {**function.__globals__, **dict(instead)}
    named = (known.get(name) for name in _names(function.__code__))
    return frozenset([function.__module__]).union(
        *(_modules(one, instead) for one in named if isinstance(one, FunctionType))
    )


def _names(code: CodeType) -> set[str]:
    inner = [one for one in code.co_consts if isinstance(one, CodeType)]
    return set(code.co_names).union(*map(_names, inner))
