"""Random damage to bytes, text and JSON values, repeatable by its seed."""

from __future__ import annotations

import json
import random
import struct
from typing import Any

NUMBERS = (0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
"""Values at the ends of integer types."""
REALS = (
    0.0, -0.0, -1.0, 5e-324, 1e-300, 1e-9, 0.5, 1e3, 1e6, 1e9, 1e18, 1e100, 1e154, 1e200, 1.7e308, -1.7e308,
)  # fmt: skip
"""Numbers that overflow, underflow or cancel in some expression."""
WORDS = (
    "",
    "nan",
    "inf",
    "-inf",
    "\0",
    "é",
    "\ud800",
    "😀",
    "x" * 5000,
    "never",
    "stop",
    "run",
    "hold",
    "on",
)
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
        if isinstance(one, dict):
            keys: Any = list(one)
        elif isinstance(one, list):
            keys = range(len(one))
        else:
            continue
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
