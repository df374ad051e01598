"""The values exchanged between a process's pure core and its transport.

A core is sans-I/O: ``step(now, inbox) -> outbox`` takes samples as bytes and returns bytes, so the same
core runs on the bus, on an in-memory network under a fake clock, and under a fuzzer.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class BadMessage(ValueError):  # noqa: N818 - it is the message that is bad
    """Bytes that are not the expected message, or a value that may not be sent; the text says why."""


class Sample(NamedTuple):
    """One received message."""

    key: str
    payload: bytes
    attachment: bytes | None
    arrived: float
    """When the receive thread received it [s, monotonic clock of this process]."""
    unverified: str = ""
    """Why its order does not count, if orders are signed, in words; empty: no objection."""
    forged: bool = False
    """Whether its sender forged it, as opposed to a certificate that is missing or out of date."""


class Outgoing(NamedTuple):
    """One message to publish."""

    key: str
    payload: bytes
    attachment: bytes | None = None


class Now(NamedTuple):
    """The two clocks of a core; it reads neither itself."""

    mono: float
    """[s] monotonic: ages, periods and time-outs."""
    wall: float
    """[s] system clock since the epoch: stamps."""


Handler = Callable[[Sample, Now], float | None]
"""Processes a message; may return the interval that it closes [s]. Raises BadMessage."""
