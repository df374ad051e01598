"""Read a recording message by message: all its parts in order, a truncated one up to its end; its metrics."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Statistics

from formation.control.laws import LAWS, UNUSABLE
from formation.mission.file import MissionError, parse
from formation.mission.model import Mission
from formation.monitor.metrics.event import clock_step, from_message
from formation.monitor.metrics.keys import OWN
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.recording.channels import ABOUT, SUFFIX, unpacked_attachment
from formation.monitor.recording.rotation import siblings
from formation.monitor.recording.scan import (
    Progress,
    Times,
    contents,
    damaged,
    ends_before,
    first_records,
    footer,
    parsed,
    records,
    summary,
    times_of,
)
from formation.ros2.messages import LogEntry, decode
from formation.topics import ERROR, EVENTS
from formation.wire import BadMessage, Now, Sample

LOOK_PERIOD = 0.1
"""Time between two looks of a live monitor [s]."""
MAX_CHUNK_TIME = 1.0
"""Longest time within a chunk, and between two, that is no sign of a clock that was set [s]."""
MAX_DISORDER = 0.1
"""Largest step back of the arrivals on one key that is no sign of a clock that was set [s]."""
_OWN = frozenset(one.key for one in OWN)


@dataclass(frozen=True)
class Extent:
    """Time span and message counts."""

    start: float | None = None
    """When the first message arrived [s, system clock of the recorder]; None if there is none."""
    end: float | None = None
    """When the last message arrived [s, that clock as if it had not been set since]."""
    counts: Counter[str] = field(default_factory=Counter)
    """Messages by key, without attachments."""
    steady: bool = True
    """Whether that clock was not set meanwhile."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return 0.0 if self.start is None or self.end is None else self.end - self.start


class UnreadableError(ValueError):
    """A file is no recording of a mission; the text names it and the cause."""


class Recorded(NamedTuple):
    """One message of a recording."""

    sample: Sample
    """Its `arrived` is `wall` by that clock as if it had not been set since the recording began."""
    wall: float
    """When it arrived [s, system clock of the recorder]."""

    @property
    def now(self) -> Now:
        """When it arrived, by both clocks."""
        return Now(self.sample.arrived, self.wall)


class Condition(NamedTuple):
    """What of a recording cannot be read."""

    is_cut: bool
    """Whether the end of a part is missing: its recorder was killed or is still running."""
    damaged: int
    """Number of stretches that cannot be read; each loses up to a chunk's messages."""

    @property
    def words(self) -> str:
        """What is missing, in words; empty if the recording is whole."""
        cut = ("cut off, or still being written",) if self.is_cut else ()
        places = "one place" if self.damaged == 1 else f"{self.damaged} places"
        damage = (f"damaged in {places}",) if self.damaged else ()
        return " and ".join(cut + damage)


@dataclass(frozen=True)
class Recording:
    """A recording's metadata. Each call of `messages` reads the messages again."""

    path: Path
    """The requested file."""
    about: Mapping[str, str]
    """Mission, law, versions: the metadata that the recorder wrote."""
    mission: Mission
    """The mission, with the law that was in use."""
    parts: tuple[Path, ...]
    """Every existing file of it, in order."""

    def messages(self, since: float = -math.inf) -> Iterator[Recorded]:
        """Yield every message of every part, with attachments, as far as it can be read.

        Messages before `since` [s, system clock of the recorder] are skipped by whole chunks, so some of them
        may still come. With chunks skipped, it does not count that the clock was set before.
        """
        return _messages(self.parts, since)

    def condition(self) -> Condition:
        """Return whether the end of a part is missing, and how much is damaged; this reads every part."""
        parts = [condition_of(part) for part in self.parts]
        return Condition(any(one.is_cut for one in parts), sum(one.damaged for one in parts))

    def extent(self) -> Extent:
        """Return its time span and message counts."""
        return extent_of(*self.parts)


def read(path: Path) -> Recording:
    """Open the recording that `path` is a part of. Raises UnreadableError if it is none."""
    about = about_of(path)
    source = f"{path}: its mission"
    try:
        mission = parse(about["mission_file"], source)
    except MissionError as error:
        raise UnreadableError(str(error)) from None
    kind = about.get("law", mission.law.kind)
    if kind not in LAWS and kind not in UNUSABLE:  # to show a recording takes no law
        raise UnreadableError(f"{path}: its law is {kind[:40]!r}; must be one of {', '.join(LAWS)}")
    return Recording(path, about, mission.under(kind), _parts(path, about))


def about_of(path: Path) -> Mapping[str, str]:
    """Return the metadata of one file. Raises UnreadableError."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe would wait for its other end
            raise UnreadableError(f"{path}: must be a file, is a pipe or a device")
        with path.open("rb") as file:
            for record in first_records(file):
                if record.opcode != Opcode.METADATA:
                    continue
                found = parsed(Metadata.read, record.body)
                if found is not None and found.name == ABOUT and "mission_file" in found.metadata:
                    metadata: dict[str, str] = found.metadata
                    return metadata
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read: {error.strerror}") from None
    raise UnreadableError(f"{path}: is no recording that `formation` made")


def condition_of(path: Path, on_progress: Progress = lambda _: None) -> Condition:
    """Return what of a file cannot be read. Raises OSError."""
    with path.open("rb") as file:
        return Condition(footer(file) is None, damaged(file, on_progress))


def _parts(path: Path, about: Mapping[str, str]) -> tuple[Path, ...]:
    """Return all files of the recording beside `path`; of two for one part, the requested one."""
    if "recording" not in about:
        return (path,)
    found = {_number(about): path}
    for other in siblings(path):
        try:
            theirs = about_of(other)
        except UnreadableError:
            continue
        if theirs.get("recording") == about["recording"]:
            found.setdefault(_number(theirs), other)
    return tuple(found[number] for number in sorted(found))


def _number(about: Mapping[str, str]) -> int:
    text = about.get("part", "")
    return int(text) if text.isdecimal() and len(text) < 10 else 1


def extent_of(*parts: Path) -> Extent:
    """Return the extent of these files in order, from their indices if possible, else from their messages.

    Raises OSError. An index counts messages in damaged stretches too.
    """
    counts: Counter[str] = Counter()
    spans, chunks = list[Times](), list[Times]()
    for part in parts:
        keys, numbers, span, found = _indexed_contents(part)
        spans += span
        chunks += found
        for number, n in numbers.items():
            if (key := keys.get(number, "")) and not key.endswith(SUFFIX):
                counts[key] += n
    if not spans:
        return Extent(counts=counts)
    start, end = min(one.first for one in spans) / 1e9, max(one.last for one in spans) / 1e9
    if _follow_closely(chunks):
        return Extent(start, end, counts)
    steady, begin, until = True, math.inf, -math.inf
    for message in _messages(parts):
        moment = message.sample.arrived
        steady &= moment == message.wall
        begin, until = min(begin, moment), max(until, moment)
    return Extent(start, end, counts) if steady else Extent(begin, until, counts, steady=False)


def _follow_closely(chunks: Sequence[Times]) -> bool:
    """Return whether a clock that was set could not be among these chunks' times."""
    longest, disorder = MAX_CHUNK_TIME * 1e9, MAX_DISORDER * 1e9
    return all(one.last - one.first <= longest for one in chunks) and all(
        -disorder <= after.first - before.last <= longest for before, after in pairwise(chunks)
    )


def _indexed_contents(part: Path) -> tuple[dict[int, str], Counter[int], list[Times], list[Times]]:
    """Return a file's keys and number of messages by channel, its time span, and the times of its chunks."""
    numbers: Counter[int] = Counter()
    with part.open("rb") as file:
        keys, statistics, chunks = _indexed(file)
        if statistics is not None and statistics.message_start_time <= statistics.message_end_time:
            numbers.update(statistics.channel_message_counts)
            span = [Times(statistics.message_start_time, statistics.message_end_time)]
            return keys, numbers, span if statistics.message_count else [], chunks or span
        chunks = []
        for record in records(file):
            if record.opcode == Opcode.CHUNK and (chunk := contents(record.body)) and chunk.messages:
                _add_keys(keys, *chunk.declared)
                numbers.update(message.channel for message in chunk.messages)
                logged = [message.logged for message in chunk.messages]
                chunks.append(Times(min(logged), max(logged)))
    return keys, numbers, chunks, chunks


class Timeline:
    """The recorder's system clock as if it had not been set. Pass the messages in the order of the file.

    The monitor's events say by how much it was set. In a recording without them a step back shows in the
    arrivals on a key, to within the time between two messages; a step forward looks like a pause, and stays.
    """

    def __init__(self) -> None:
        self._ahead = 0.0  # the system clock before this time [s]
        self._newest = -math.inf
        self._last: dict[str, float] = {}  # by key

    def moment(self, key: str, payload: bytes, wall: float) -> float:
        """Return the time [s] of the next message, which arrived at `wall` [s, recorder's system clock]."""
        if key == EVENTS.key():
            with suppress(BadMessage):
                self._ahead += clock_step(from_message(decode(LogEntry, payload)))
        moment = wall - self._ahead
        if moment < self._last.get(key, -math.inf) - MAX_DISORDER:
            moment, self._ahead = self._newest, wall - self._newest
        self._last[key], self._newest = moment, max(self._newest, moment)
        return moment


def _messages(parts: Sequence[Path], since: float = -math.inf) -> Iterator[Recorded]:
    timeline = Timeline()
    for part in parts:
        with part.open("rb") as file:
            for key, payload, attachment, wall in _messages_of(file, since):
                moment = timeline.moment(key, payload, wall)
                yield Recorded(Sample(key, payload, attachment, moment), wall)


def _messages_of(file: IO[bytes], since: float) -> Iterator[tuple[str, bytes, bytes | None, float]]:
    """Yield key, payload, attachment and arrival [s] of each message of one file."""
    keys = _indexed(file)[0]  # the chunk that declares them may be damaged
    indexed = bool(keys)
    attachments: dict[str, bytes] = {}
    for record in records(file):
        if record.opcode == Opcode.CHANNEL:
            _add_keys(keys, parsed(Channel.read, record.body))
        if record.opcode != Opcode.CHUNK or (indexed and ends_before(record, since)):
            continue
        if (chunk := contents(record.body)) is None:
            continue
        _add_keys(keys, *chunk.declared)
        if ends_before(record, since):
            continue
        for message in chunk.messages:
            key = keys.get(message.channel, "")
            if key.endswith(SUFFIX):
                attachments[key.removesuffix(SUFFIX)] = unpacked_attachment(message.data)
            elif key:
                yield key, message.data, attachments.pop(key, None), message.logged / 1e9


def _indexed(file: IO[bytes]) -> tuple[dict[int, str], Statistics | None, list[Times]]:
    """Return all channels' keys, statistics and the times of all chunks, from the index at the end if any."""
    keys: dict[int, str] = {}
    statistics = None
    chunks = []
    for record in summary(file):
        if record.opcode == Opcode.CHANNEL:
            _add_keys(keys, parsed(Channel.read, record.body))
        elif record.opcode == Opcode.STATISTICS:
            statistics = parsed(Statistics.read, record.body)
        elif record.opcode == Opcode.CHUNK_INDEX and (times := times_of(record)) is not None:
            chunks.append(times)
    return keys, statistics, chunks


def _add_keys(keys: dict[int, str], *channels: Channel | None) -> None:
    for channel in channels:
        if channel is not None:
            keys[channel.id] = channel.topic.removeprefix("/")


class Rerun:
    """A recording's metrics up to the newest message taken, as the monitor's own were fed live.

    The live monitor judged the formation error at the moments of its publication, which are recorded, so
    settling and the final error come out the same. While an edge is unknown nothing is published; the known
    edges are then judged every `LOOK_PERIOD`. The monotonic clock is the recorder's system clock as if it had
    not been set since the recording began.
    """

    def __init__(self, mission: Mission) -> None:
        self.metrics = Metrics(mission)
        self._looked = -math.inf  # [s, monotonic]

    def process_message(self, message: Recorded) -> None:
        """Take the next message of the file."""
        now = message.now
        if message.sample.key not in _OWN:
            self.metrics.process_sample(message.sample, now.wall)
        elif message.sample.key == ERROR.key():
            self.metrics.observe(now)
            self._looked = now.mono
        if now.mono - self._looked > 1.5 * LOOK_PERIOD:
            self.metrics.observe(now, known_only=True)
            self._looked = now.mono
