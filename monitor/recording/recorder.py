"""The recorder: it writes every received message, byte for byte, as a ROS 2 bag in MCAP.

A recording must survive a kill and a power cut: twice a second the messages go to a thread that writes them
and forces them to the disk, so that at most a second is lost. Such a file has no end; `read` reads it all
the same, and `formation recover` adds an end.
"""

from __future__ import annotations

import logging
import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Self

from formation.monitor.metrics.keys import Watched
from formation.monitor.recording.channels import SUFFIX, TYPE, Channels, about, packed_attachment
from formation.monitor.recording.disk import Disk, Notice
from formation.monitor.recording.part import Chunk
from formation.monitor.recording.rotation import FREE_SPACE, ROTATION, FreeSpace, Rotation
from formation.ros2.definitions import definition
from formation.transport.runtime.process import BadInput
from formation.wire import Sample

CHUNK_BYTES = 1024 * 1024
"""Length from which on a chunk is full [bytes]; reading one takes as much memory."""
MAX_MESSAGE_BYTES = 8 * 1024 * 1024
"""Longest message, with its attachment, that is recorded [bytes]: readers refuse chunks of twice that."""
FLUSH_PERIOD = 0.5
"""Time between writes [s]. A loop or a disk that is late by as much still loses less than a second."""
MAX_WAITING_BYTES = 64 * 1024 * 1024
"""Most data that may wait for a slow disk [bytes]: 25 s of 6000 messages a second."""
MIN_REPORTED_DELAY = 2.0
"""Delay of the disk from which on it is reported [s]."""
STOP_TIMEOUT_SECONDS = 20.0
"""Longest time for ending a recording [s]."""
_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")
_log = logging.getLogger(__name__)


class RecordingError(BadInput):
    """The recording cannot be started; the text names the file and the cause."""


class Recorder:
    """One recording. Close it, best as a context manager; failures after the start never raise."""

    def __init__(
        self,
        path: Path,
        mission: str,
        text: str,
        law: str,
        keys: Iterable[Watched],
        rotation: Rotation = ROTATION,
        room: FreeSpace = FREE_SPACE,
        metadata: Mapping[str, str] = MappingProxyType({}),
        *,
        in_step: bool = False,
    ) -> None:
        """Begin `path`, which must not exist, for `keys`. Raises RecordingError.

        `mission` is the mission's name, `text` its file and `law` the one in use; the recording holds all.
        `metadata` replaces what is said about the machine and the time. With `in_step`, for a simulated
        clock, the caller waits for each write, and nothing is forced to the disk.
        """
        self.path = path
        """The first part."""
        self._channels = Channels()
        self._keys = {
            one.key: (self._channels.register(one.key, one.topic.type), is_stamped(one.topic.type))
            for one in keys
        }
        """Number of its channel, and whether its messages begin with a stamp, by key."""
        self._attached: dict[str, int] = {}
        self._sequence: Counter[str] = Counter()
        self._in_step = in_step
        self._chunk = Chunk()
        self._waiting: deque[int] = deque()  # lengths of the chunks not yet written
        self._unsafe: deque[float] = deque()  # when the chunks not yet forced were handed over
        self._handed, self._dropped = 0, 0
        self._too_long: set[str] = set()  # keys with messages that are too long
        self._flush_due: float | None = None
        self._is_late = self._is_full = self._is_closed = False
        try:
            self._disk = Disk(
                path,
                about(mission, text, law) | dict(metadata),
                self._channels,
                rotation,
                room,
                forces=not in_step,
            )
        except OSError as error:
            raise RecordingError(_why(path, error)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every part so far."""
        return self._disk.paths

    @property
    def bytes(self) -> int:
        """Number of bytes written."""
        return self._disk.safe.size

    @property
    def recorded(self) -> Counter[str]:
        """Number of messages on the disk, by key."""
        counts = self._disk.safe.counts
        return Counter({key: counts[number] for key, (number, _) in self._keys.items() if counts[number]})

    @property
    def lost(self) -> int:
        """Number of messages (with attachments) that could not be recorded."""
        return self._dropped + self._disk.lost

    @property
    def failure(self) -> str | None:
        """Why nothing is being recorded now; None if it is."""
        if self._is_full:
            return "the disk is too slow"
        if not self._is_closed and not self._disk.is_alive:
            return "the thread that writes the recording has ended"
        return self._disk.failure

    def notices(self) -> Iterator[Notice]:
        """Yield the notices since the last call. They have been logged already."""
        while self._disk.notices:
            yield self._disk.notices.popleft()

    def write(self, sample: Sample, wall: float) -> None:
        """Record one message, as received, that arrived at `wall` [s, our system clock]."""
        known = self._keys.get(sample.key)
        if known is None or self._is_too_long(sample):
            return
        channel, stamped = known
        arrived = max(round(wall * 1e9), 0)  # an unset clock may be before 1970
        stamp = stamp_of(sample.payload) if stamped else None
        sent = arrived if stamp is None else stamp
        self._sequence[sample.key] += 1
        sequence = self._sequence[sample.key] & 0xFFFFFFFF
        if sample.attachment is not None:
            attached = packed_attachment(sample.attachment)
            if attached is not None:
                self._chunk.add(self._attachment_channel(sample.key), sequence, arrived, sent, attached)
        self._chunk.add(channel, sequence, arrived, sent, sample.payload)
        if len(self._chunk.raw) > CHUNK_BYTES:
            self._hand_over(self._flush_due or 0.0)

    def _is_too_long(self, sample: Sample) -> bool:
        """Count a message that no reader would take, and report the first one of each key."""
        length = len(sample.payload) + len(sample.attachment or b"")
        if length <= MAX_MESSAGE_BYTES:
            return False
        self._dropped += 1
        if sample.key not in self._too_long:
            self._too_long.add(sample.key)
            limit = f"at most {MAX_MESSAGE_BYTES} are recorded"
            what = f"not recorded: {sample.key} with a message of {length} bytes; {limit}"
            self._disk.notify(logging.ERROR, what)
        return True

    def flush(self, mono: float) -> None:
        """Hand over the chunk for writing, at most once a period; `mono` [s]. Call it often."""
        if self._flush_due is None:
            self._flush_due = mono + FLUSH_PERIOD
        if mono >= self._flush_due:
            self._flush_due = mono + FLUSH_PERIOD
            self._hand_over(mono)
            if self._in_step:
                self._disk.catch_up(STOP_TIMEOUT_SECONDS)
            self._check_disk(mono)

    def close(self) -> None:
        """Write the index and end the file. May be called twice."""
        if self._is_closed:
            return
        self._hand_over(self._flush_due or 0.0)
        self._is_closed = True
        if not self._disk.close(STOP_TIMEOUT_SECONDS):
            _log.error("%s: the disk does not answer, the end of the recording is missing", self.paths[-1])

    def _attachment_channel(self, key: str) -> int:
        number = self._attached.get(key)
        if number is None:
            number = self._attached[key] = self._channels.register(key + SUFFIX, TYPE)
        return number

    def _hand_over(self, mono: float) -> None:
        chunk = self._chunk
        if not chunk.raw:
            return
        self._chunk = Chunk()
        if self._is_full:
            self._dropped += chunk.total
            return
        chunk.channels, chunk.handed = len(self._channels.channels), mono
        self._waiting.append(len(chunk.raw))
        self._unsafe.append(mono)
        self._handed += 1
        self._disk.queue_chunk(chunk)

    def _check_disk(self, mono: float) -> None:
        while len(self._waiting) > self._handed - self._disk.written:
            self._waiting.popleft()
        while len(self._unsafe) > self._handed - self._disk.safe.number:
            self._unsafe.popleft()
        behind = mono - self._unsafe[0] if self._unsafe else 0.0
        if behind > MIN_REPORTED_DELAY and not self._is_late:
            text = f"the disk is {behind:.1f} s behind, limit {MIN_REPORTED_DELAY:g} s"
            self._disk.notify(logging.WARNING, f"{text}: a power cut would lose that; use a faster disk")
        self._is_late = behind > MIN_REPORTED_DELAY
        full = sum(self._waiting) > (MAX_WAITING_BYTES // 2 if self._is_full else MAX_WAITING_BYTES)
        if full and not self._is_full:
            waiting = f"{sum(self._waiting) / 1e6:.0f} MB wait, limit {MAX_WAITING_BYTES / 1e6:.0f} MB"
            text = f"nothing is recorded any more: the disk is {behind:.0f} s behind, {waiting}"
            self._disk.notify(logging.ERROR, f"{text}; continues when half of that is written")
        elif self._is_full and not full:
            self._disk.notify(logging.WARNING, "recording continues: the disk has caught up")
        self._is_full = full


def is_stamped(ros_type: str) -> bool:
    """Return whether messages of this type begin with a std_msgs/Header."""
    return definition(ros_type).lstrip().startswith("std_msgs/Header ")


def stamp_of(payload: bytes) -> int | None:
    """Return the stamp of a message that begins with a std_msgs/Header [ns]; None if it is invalid."""
    if len(payload) < 12 or payload[0] != 0 or payload[1] > 1:
        return None
    seconds, nanoseconds = (_LITTLE if payload[1] else _BIG).unpack_from(payload, 4)
    return seconds * 10**9 + nanoseconds if seconds >= 0 and nanoseconds < 10**9 else None


def _why(path: Path, error: OSError) -> str:
    if isinstance(error, FileExistsError):
        reason = "exists already; name a new file"
        return f"--record {path}: {reason if path.exists() else f'{path.parent} is no folder'}"
    return f"--record {path}: cannot be written: {error.strerror}"
