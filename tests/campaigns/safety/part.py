"""What every part is asked, and what it gives.

A part is a module with a TITLE, ABOUT (what was done and under which conditions, in sentences),
`run(options)`, whose result has ``bars``, each of `bar`, and `section(found)`: tables for people.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tests.campaigns.figures import progress

T = TypeVar("T")


class Options(NamedTuple):
    """What was asked for on the command line."""

    quick: bool = False  # a few tries that show that it works; the figures mean little
    jobs: int = 1  # processes side by side, for parts whose tries are processes of their own
    figures: Path | None = None  # the folder that pictures go into; none are wanted without one


def bar(words: str, found: str, held: bool) -> dict[str, Any]:
    """One bar: what is asked for, what came out, whether that is enough."""
    return {"bar": words, "found": found, "held": bool(held)}


def reported(name: str, tries: Sequence[T]) -> Iterator[T]:
    """The same one by one, with progress."""
    tell = reporting(name)
    for done, one in enumerate(tries):
        yield one
        tell((done + 1) / len(tries))


def reporting(name: str, every: float = 2.0) -> Callable[[float], None]:
    """What is to be told the share done, for a line on stderr every so often [s]."""
    began = last = time.monotonic()

    def tell(done: float) -> None:
        nonlocal last
        now = time.monotonic()
        if done > 0.0 and now - last >= every:
            left = (now - began) * (1.0 / done - 1.0)
            progress(f"{name}: {100 * done:.0f} %, {left:.0f} s left")
            last = now

    return tell
