"""What crosses the border between a process's pure core and its transport.

A core is sans-I/O: ``step(now, inbox) -> outbox`` takes samples as bytes and gives bytes back, so the same
core runs on the bus, on an in-memory network under a fake clock, and under a fuzzer.
"""

from __future__ import annotations

from typing import NamedTuple


class BadMessage(ValueError):  # noqa: N818 - it is the message that is bad
    """Bytes that are not the message they claim to be, or a value that may not be sent; the text says why."""


class Sample(NamedTuple):
    """One message as it arrived."""

    key: str
    payload: bytes
    attachment: bytes | None
    arrived: float
    """When the receive thread had it [s, monotonic clock of this process]."""
    unverified: str = ""
    """Why the order on it does not count, where orders are signed, in words; empty: nothing against it."""
    forged: bool = False
    """Whether that is the sender's doing, and no matter of certificates that are on their way or too old."""


class Outgoing(NamedTuple):
    """One message to publish."""

    key: str
    payload: bytes
    attachment: bytes | None = None


class Now(NamedTuple):
    """The two clocks a core may know; it reads neither itself."""

    mono: float
    """[s] monotonic: ages, periods and time-outs."""
    wall: float
    """[s] system clock since the epoch: stamps."""
