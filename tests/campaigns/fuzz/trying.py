"""One reader after another on one damaged input after another; what they raise, and what takes too long."""

from __future__ import annotations

import resource
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NamedTuple

MAX_SECONDS = 10.0
"""One reader may take so long for one input of a few kilobytes [s, of the processor]."""


class TooLong(BaseException):
    """A reader has not ended in time. No `except Exception` of the product takes it."""


class Finding(NamedTuple):
    """Something that a reader must not do."""

    reader: str
    seed: int
    what: str
    """Type and text of what was raised, and where."""


class Tried(NamedTuple):
    """What came of one reader and one input."""

    finding: Finding | None
    refused: bool
    seconds: float


def attempt(
    reader: str, seed: int, do: Callable[[], object], allowed: tuple[type[BaseException], ...]
) -> Tried:
    """Call `do`; `allowed` is how it may refuse."""
    begin, finding, refused = time.process_time(), None, False
    try:
        with _limited(MAX_SECONDS):
            do()
    except allowed as refusal:
        refused = True
        if "\n" in str(refusal):
            finding = Finding(reader, seed, f"refused in more than one line: {str(refusal)[:200]!r}")
    except (Exception, TooLong) as error:  # noqa: BLE001 - this is what is looked for
        last = traceback.extract_tb(error.__traceback__)[-1]
        finding = Finding(reader, seed, f"{_told(error)} at {last.filename}:{last.lineno}")
    return Tried(finding, refused, time.process_time() - begin)


def _told(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error)[:120]}"


def peak_memory() -> float:
    """The most memory that this process has had so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raise TooLong in the main thread after so long."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TooLong(f"took over {seconds:g} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
