"""Turn messages from a bus into facts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Protocol

from formation.deploy.doctor.facts import ReceivedMessage, Stream
from formation.protocol import status_codec
from formation.protocol.status import AgentStatus, LeaderStatus
from formation.ros2.messages import BadMessage, Diagnostics, Number, Odometry, Pose, decode
from formation.transport.bus import Bus
from formation.wire import Sample


class _Stamped(Protocol):
    @property
    def stamp(self) -> float: ...


Listened = dict[str, list[tuple[Sample, float]]]
"""Received samples by key, each with our system clock at its arrival [s]."""


def listen(bus: Bus, seconds: float, enough: Iterable[str] = ()) -> Listened:
    """Return what arrives within `seconds`; stop early once every key in `enough` had a message."""
    received: Listened = {}
    awaited = set(enough)
    ends = time.monotonic() + seconds
    while (left := ends - time.monotonic()) > 0.0:
        bus.wait(left)
        offset = time.time() - time.monotonic()
        for sample in bus.drain():
            received.setdefault(sample.key, []).append((sample, sample.arrived + offset))
        if awaited and awaited <= received.keys():
            break
    return received


def odometry(samples: Sequence[tuple[Sample, float]]) -> Stream:
    """Return the received odometry."""
    return _stream(partial(decode, Odometry), samples)


def poses(samples: Sequence[tuple[Sample, float]]) -> Stream:
    """Return the received poses."""
    return _stream(partial(decode, Pose), samples)


def statuses(
    kind: type[AgentStatus | LeaderStatus], samples: Sequence[tuple[Sample, float]]
) -> tuple[Stream, AgentStatus | LeaderStatus | None]:
    """Return the received statuses of a kind, and the newest."""
    newest: list[AgentStatus | LeaderStatus] = []

    def read(payload: bytes) -> Diagnostics:
        message = decode(Diagnostics, payload)
        status = status_codec.from_message(kind, message)
        newest[:] = newest if status is None else [status]
        return message

    stream = _stream(read, samples)
    return stream, newest[0] if newest else None


def signs(samples: Sequence[tuple[Sample, float]]) -> tuple[tuple[float, float], ...]:
    """Return signs of life: arrival [s, monotonic], and stated time [s]."""
    found = []
    for sample, _ in samples:
        try:
            found.append((sample.arrived, decode(Number, sample.payload).value))
        except BadMessage:
            continue
    return tuple(found)


def _stream(read: Callable[[bytes], _Stamped], samples: Sequence[tuple[Sample, float]]) -> Stream:
    received, bad, frames = [], [], set()
    for sample, wall in samples:
        try:
            message = read(sample.payload)
        except BadMessage as error:
            bad.append(str(error))
            continue
        received.append(ReceivedMessage(sample.arrived, message.stamp, wall))
        frames.add(str(getattr(message, "frame", "")))
    return Stream(tuple(received), frozenset(frames), tuple(bad))
