"""What every part is asked, and what it gives."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from tests.campaigns.document import Found

T = TypeVar("T")


class Options(NamedTuple):
    """What was asked for on the command line."""

    quick: bool = False
    """A few tries that show that it works; the figures mean little."""
    jobs: int = 1
    """Processes side by side, for parts whose tries are processes of their own."""
    figures: Path | None = None
    """The folder that pictures go into; none are wanted without one."""


class Part(Protocol):
    """A module of this folder, named in `tests.campaigns.safety.__main__.PARTS`."""

    TITLE: str
    ABOUT: str
    """What was done and under which conditions, in sentences."""

    def run(self, options: Options) -> Found:
        """Do it; what was found, with ``bars``: a list of what `bar` gives, shown above the section."""

    def section(self, found: Found) -> str:
        """Tables for people, and pictures as ``![what it shows](figures/safety_NAME.svg)``."""


def bar(words: str, found: str, held: bool) -> dict[str, Any]:
    """One bar: what is asked for, what came out, whether that is enough."""
    return {"bar": words, "found": found, "held": bool(held)}


def reported(name: str, tries: Sequence[T]) -> Iterator[T]:
    """The same one by one, and who waits is told how far it is."""
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
            print(f"{name}: {100 * done:.0f} %, {left:.0f} s left", file=sys.stderr, flush=True)
            last = now

    return tell
