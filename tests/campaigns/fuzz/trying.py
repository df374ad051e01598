"""One reader after another on one damaged input after another; what they raise, and what takes too long."""

from __future__ import annotations

import io
import json
import random
import signal
import struct
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from types import FrameType
from typing import Any, NamedTuple

NUMBERS = (0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
"""Values at the ends of integer types."""
REALS = (
    0.0, -0.0, -1.0, 5e-324, 1e-300, 1e-9, 0.5, 1e3, 1e6, 1e9, 1e18, 1e100, 1e154, 1e200, 1.7e308, -1.7e308,
)  # fmt: skip
"""Numbers that overflow, underflow or cancel in some expression."""
WORDS = (
    "", "nan", "inf", "-inf", "\0", "é", "\ud800", "😀", "x" * 5000, "never", "stop", "run", "hold", "on",
)  # fmt: skip
"""Text that a reader may not expect."""
_WIDTHS = {1: "<B", 2: "<H", 4: "<I", 8: "<Q"}


def damaged(data: bytes, chance: random.Random, most: int = 4) -> bytes:
    """`data` after one to `most` random edits: bits, numbers, cuts, repetitions, insertions."""
    out = bytearray(data)
    for _ in range(chance.randint(1, most)):
        _edit(out, chance)
    return bytes(out)


def _edit(out: bytearray, chance: random.Random) -> None:
    at = chance.randrange(len(out) + 1)
    length = min(int(chance.paretovariate(0.7)), 300)
    match chance.randrange(6):
        case 0 if at < len(out):
            out[at] ^= 1 << chance.randrange(8)
        case 1:
            width = chance.choice(tuple(_WIDTHS))
            value = chance.choice(NUMBERS) & (2 ** (8 * width) - 1)
            out[at : at + width] = struct.pack(_WIDTHS[width], value)
        case 2:
            del out[at : at + length]
        case 3:
            out[at:at] = out[at : at + length]
        case 4:
            out[at:at] = chance.randbytes(min(length, 20))
        case _ if at < len(out):
            out[at] = chance.randrange(256)


def changed(value: Any, chance: random.Random) -> Any:
    """A JSON value in which one place, chosen at random, holds something else."""
    places = list(_places(value))
    where, key = chance.choice(places) if places else (None, None)
    if where is None:
        return _other(value, chance)
    match chance.randrange(8):
        case 0 if isinstance(where, dict):
            where[chance.choice(("", "x", *map(str, where)))] = where.pop(key)
        case 1:
            del where[key]
        case 2 if isinstance(where, list):
            where *= chance.choice((0, 2, 50))
        case _:
            where[key] = _other(where[key], chance)
    return value


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every place inside a value: its container, and the key or index there."""
    found: list[tuple[Any, Any]] = []
    stack = [value]
    while stack:
        one = stack.pop()
        keys = list(one) if isinstance(one, dict) else range(len(one)) if isinstance(one, list) else ()
        found += [(one, key) for key in keys]
        stack += [one[key] for key in keys]
    return found


def _other(value: Any, chance: random.Random) -> Any:
    """Mostly of the same type, so that it passes the first check."""
    if chance.random() < 0.3:
        return chance.choice((None, True, False, 0, -1, 2**63, 10**400, 1.5, "", "nan", "inf", [], {}, [[]]))
    alike: tuple[Any, ...] = (json.loads(json.dumps(value)),)
    match value:
        case bool():
            alike = (not value,)
        case int():
            alike = (*NUMBERS, value + 1, value - 1, -value)
        case float():
            alike = (*REALS, -value, value + 1.0, value * 1e6, value * (1.0 + 1e-9))
        case str():
            alike = (*WORDS, value * 2, value[:-1])
        case list() if value:
            alike = (value * 3, value[:-1], value[::-1], [])
    return chance.choice(alike)


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
        what = f"{type(error).__name__}: {str(error)[:120]} at {last.filename}:{last.lineno}"
        finding = Finding(reader, seed, what)
    return Tried(finding, refused, time.process_time() - begin)


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


def quiet(main: Callable[[list[str]], int], arguments: list[str]) -> int:
    """The exit code of a command; its output is not read."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        return main(arguments)
