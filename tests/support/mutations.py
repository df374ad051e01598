"""Payloads that went wrong on the way: what a fuzz test feeds to readers of the wire."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence

LENGTHS = (0, 1, 2, 3, 5, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF)
NUMBERS = (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, -0.0, 1e6, 1e7, 1e3, 2.0)

Mutation = Callable[[random.Random, Sequence[bytes]], bytes]


def flipped(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """A few bits the other way round."""
    data = bytearray(rng.choice(corpus))
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def cut(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Only a beginning, or only an end."""
    data = rng.choice(corpus)
    at = rng.randrange(len(data))
    return data[:at] if rng.random() < 0.7 else data[at:]


def longer(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Something behind the end."""
    return rng.choice(corpus) + rng.randbytes(rng.choice((1, 2, 3, 4, 8, 100)))


def spliced(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """The beginning of one and the end of another."""
    first, second = rng.choice(corpus), rng.choice(corpus)
    return first[: rng.randrange(len(first) + 1)] + second[rng.randrange(len(second) + 1) :]


def mislengthed(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Another number where a length may stand."""
    data = bytearray(rng.choice(corpus))
    at = 4 * rng.randrange(len(data) // 4)
    data[at : at + 4] = struct.pack("<I", rng.choice(LENGTHS))
    return bytes(data)


def renumbered(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Another float where one may stand."""
    data = bytearray(rng.choice(corpus))
    at = 4 + 8 * rng.randrange(max(1, (len(data) - 4) // 8))
    data[at : at + 8] = struct.pack("<d", rng.choice(NUMBERS))
    return bytes(data)


def reheaded(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Another header: byte order, representation, none at all."""
    data = rng.choice(corpus)
    return rng.choice((b"\0\0\0\0", b"\0\3\0\0", b"\0\1\0\3", rng.randbytes(4), b"")) + data[4:]


def random_bytes(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Noise, as long as a message of `corpus`, half of the time behind a proper header."""
    size = len(rng.choice(corpus))
    return rng.choice((b"\0\1\0\0", b"")) + rng.randbytes(size)


def untouched(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """A valid message of another type than expected."""
    return rng.choice(corpus)


MUTATIONS: tuple[Mutation, ...] = (
    flipped, cut, longer, spliced, mislengthed, renumbered, reheaded, random_bytes, untouched,
)  # fmt: skip


def mutated(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """One payload made from `corpus` by a mutation drawn from `rng`."""
    return rng.choice(MUTATIONS)(rng, corpus)
