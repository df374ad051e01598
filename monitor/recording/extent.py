"""The extent of a file of a recording, from its index if it has one, else from its messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Channel, Statistics

from formation.monitor.recording.attached import SUFFIX
from formation.monitor.recording.scan import contents, footer, records, summary, understood


@dataclass(frozen=True)
class Extent:
    """Time span and message counts. Extents of parts add up."""

    start: float | None = None
    """When the first message arrived [s, system clock of the recorder]; None if there is none."""
    end: float | None = None
    """When the last message arrived [s]."""
    counts: Counter[str] = field(default_factory=Counter)
    """Messages by key, without attachments."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return 0.0 if self.start is None or self.end is None else self.end - self.start

    def __add__(self, other: Extent) -> Extent:
        starts = [one for one in (self.start, other.start) if one is not None]
        ends = [one for one in (self.end, other.end) if one is not None]
        return Extent(min(starts, default=None), max(ends, default=None), self.counts + other.counts)


def extent_of(path: Path) -> Extent:
    """Return the extent of one file. Raises OSError."""
    with path.open("rb") as file:
        return (_indexed(file) if footer(file) is not None else None) or _counted(file)


def _indexed(file: IO[bytes]) -> Extent | None:
    keys: dict[int, str] = {}
    statistics = None
    for record in summary(file):
        if record.opcode == Opcode.CHANNEL and (channel := understood(Channel.read, record.body)):
            keys[channel.id] = channel.topic.removeprefix("/")
        elif record.opcode == Opcode.STATISTICS:
            statistics = understood(Statistics.read, record.body)
    if statistics is None or statistics.message_start_time > statistics.message_end_time:
        return None
    counts = Counter({keys.get(number, ""): n for number, n in statistics.channel_message_counts.items()})
    times = statistics.message_start_time / 1e9, statistics.message_end_time / 1e9
    return _extent(times if statistics.message_count else None, counts)


def _counted(file: IO[bytes]) -> Extent:
    keys: dict[int, str] = {}
    numbers: Counter[int] = Counter()
    first, last = [], 0
    for record in records(file):
        if record.opcode != Opcode.CHUNK or (chunk := contents(record.body)) is None or not chunk.messages:
            continue
        keys.update({channel.id: channel.topic.removeprefix("/") for channel in chunk.declared})
        numbers.update(message.channel for message in chunk.messages)
        first.append(min(message.logged for message in chunk.messages))
        last = max(last, *(message.logged for message in chunk.messages))
    counts = Counter({keys.get(number, ""): n for number, n in numbers.items()})
    return _extent((min(first) / 1e9, last / 1e9) if first else None, counts)


def _extent(times: tuple[float, float] | None, counts: Counter[str]) -> Extent:
    kept = Counter({key: n for key, n in counts.items() if key and not key.endswith(SUFFIX)})
    start, end = times or (None, None)
    return Extent(start, end, kept)
