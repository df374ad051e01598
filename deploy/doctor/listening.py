"""Turns what arrives on a bus into facts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Protocol

from deploy.doctor.facts import Heard, Stream
from formation.ros2.messages import BadMessage, Diagnostics, Number, Odometry, Pose, Status, decode
from formation.transport.bus import Bus
from formation.wire import Sample


class _Stamped(Protocol):
    @property
    def stamp(self) -> float: ...


Listened = dict[str, list[tuple[Sample, float]]]
"""What came, by key: each sample, and our system clock when it did [s]."""


def listen(bus: Bus, seconds: float, enough: Iterable[str] = ()) -> Listened:
    """Everything that comes in `seconds`; less, if something came on each key of `enough`."""
    heard: Listened = {}
    awaited = set(enough)
    ends = time.monotonic() + seconds
    while (left := ends - time.monotonic()) > 0.0:
        bus.wait(left)
        offset = time.time() - time.monotonic()
        for sample in bus.drain():
            heard.setdefault(sample.key, []).append((sample, sample.arrived + offset))
        if awaited and awaited <= heard.keys():
            break
    return heard


def odometry(samples: Sequence[tuple[Sample, float]]) -> Stream:
    """Odometry as it came."""
    return _stream(partial(decode, Odometry), samples)


def poses(samples: Sequence[tuple[Sample, float]]) -> Stream:
    """Poses as they came."""
    return _stream(partial(decode, Pose), samples)


def statuses(samples: Sequence[tuple[Sample, float]]) -> tuple[Stream, Status | None]:
    """Statuses as they came, and the newest."""
    newest = None
    for sample, _ in samples:
        try:
            newest = next(iter(decode(Diagnostics, sample.payload).statuses), newest)
        except BadMessage:
            continue
    return _stream(partial(decode, Diagnostics), samples), newest


def signs(samples: Sequence[tuple[Sample, float]]) -> tuple[tuple[float, float], ...]:
    """Signs of life: arrival [s, monotonic], and what they say [s]."""
    found = []
    for sample, _ in samples:
        try:
            found.append((sample.arrived, decode(Number, sample.payload).value))
        except BadMessage:
            continue
    return tuple(found)


def _stream(read: Callable[[bytes], _Stamped], samples: Sequence[tuple[Sample, float]]) -> Stream:
    heard, bad, frames = [], [], set()
    for sample, wall in samples:
        try:
            message = read(sample.payload)
        except BadMessage as error:
            bad.append(str(error))
            continue
        heard.append(Heard(sample.arrived, message.stamp, wall))
        frames.add(str(getattr(message, "frame", "")))
    return Stream(tuple(heard), frozenset(frames), tuple(bad))
