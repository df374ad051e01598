"""The recording: everything heard, byte for byte, as a ROS 2 bag in MCAP.

A recording must survive its recorder: every second the chunk is ended and handed to the operating system, so
a process that is killed loses about a second. Such a file has no end; `mcap`'s StreamReader reads it.
"""

from __future__ import annotations

import logging
import os
import struct
import sys
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import CompressionType, Writer

from formation.ros2.messages import definition, type_hash
from formation.transport.process import BadInput
from formation.wire import Sample
from monitor.figures.keys import Watched
from monitor.recording.attached import SUFFIX, TYPE, packed

CHUNK = 1024 * 1024
"""Longest chunk [bytes]. It is the flush that limits what can be lost; smaller ones would only make the index
grow, which the writer holds in memory: at 6000 messages a second by 1.7 GB an hour at 64 KiB."""
FLUSH_PERIOD = 1.0
"""[s]"""
PACKAGES = ("formation", "eclipse-zenoh", "mcap", "numpy", "pydantic", "rosbags")
QOS = """\
- history: 1
  depth: 10
  reliability: 2
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""What `ros2 bag play` offers: keep last 10, best effort, volatile. As numbers, which every ROS 2 reads."""
_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")
_log = logging.getLogger(__name__)


class RecordingError(BadInput):
    """The recording cannot be begun; the text names the file and says why."""


class Recorder:
    """One recording. Close it, best as a context manager; what fails after the beginning never raises."""

    def __init__(self, path: Path, mission: str, text: str, law: str, keys: Iterable[Watched]) -> None:
        """Begin `path`, which must not exist, for `keys`. Raises RecordingError.

        `mission` is the mission's name, `text` its file and `law` the one in use; all go into the recording.
        """
        self.path = path
        self.recorded: Counter[str] = Counter()
        """Messages that have reached the file, by key."""
        self.failure: str | None = None
        """Why nothing is recorded any more."""
        self._written: Counter[str] = Counter()
        self._flush_due: float | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except OSError as error:
            raise RecordingError(_why(path, error)) from None
        try:
            self._writer = Writer(self._file, chunk_size=CHUNK, compression=CompressionType.LZ4)
            self._writer.start(profile="ros2", library=f"formation {version('formation')}")
            self._writer.add_metadata("formation", _about(mission, text, law))
            self._schemas: dict[str, int] = {}
            self._attached: dict[str, int] = {}
            self._channels = {one.key: self._declare(one) for one in keys}
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._good = self._file.tell()
        except OSError as error:
            self._abandon()
            with suppress(OSError):
                path.unlink()
            raise RecordingError(_why(path, error)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, sample: Sample, wall: float) -> None:
        """Record one message, as received, that arrived at `wall` [s, our system clock]."""
        channel = self._channels.get(sample.key)
        if channel is None or self.failure is not None:
            return
        number, stamped = channel
        arrived = round(wall * 1e9)
        count = self._written[sample.key] + 1
        stamp = stamp_of(sample.payload) if stamped else None
        sent, sequence = arrived if stamp is None else stamp, count & 0xFFFFFFFF
        beside = None if sample.attachment is None else packed(sample.attachment)
        try:
            if beside is not None:
                self._writer.add_message(self._beside(sample.key), arrived, beside, sent, sequence)
            self._writer.add_message(number, arrived, sample.payload, sent, sequence)
        except OSError as error:
            self._fail(error)
            return
        self._written[sample.key] = count

    def flush(self, mono: float) -> None:
        """Hand over to the operating system, if the last time was a period ago; `mono` [s]. Call it often."""
        if self._flush_due is None:
            self._flush_due = mono + FLUSH_PERIOD
        if mono < self._flush_due or self.failure is not None:
            return
        self._flush_due = mono + FLUSH_PERIOD
        self._flush()

    def close(self) -> None:
        """Write the index and end the file. Doing so twice does no harm."""
        if self._file.closed:
            return
        if self.failure is None:
            self._flush()
        if self.failure is None:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.close()
            except OSError as error:
                self._fail(error)

    def _declare(self, one: Watched) -> tuple[int, bool]:
        """Its channel's number, and whether its messages begin with a stamp."""
        number = self._register(one.key, one.topic.type)
        return number, definition(one.topic.type).lstrip().startswith("std_msgs/Header ")

    def _beside(self, key: str) -> int:
        """The channel of what rides on `key`, which there is once something does."""
        number = self._attached.get(key)
        if number is None:
            number = self._attached[key] = self._register(key + SUFFIX, TYPE)
        return number

    def _register(self, key: str, ros_type: str) -> int:
        if ros_type not in self._schemas:
            text = definition(ros_type).encode()
            self._schemas[ros_type] = self._writer.register_schema(ros_type, "ros2msg", text)
        metadata = {"offered_qos_profiles": QOS, "topic_type_hash": type_hash(ros_type)}
        return self._writer.register_channel(f"/{key}", "cdr", self._schemas[ros_type], metadata)

    def _flush(self) -> None:
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._good = self._file.tell()
        except OSError as error:
            self._fail(error)
        else:
            self.recorded = self._written.copy()

    def _fail(self, error: OSError) -> None:
        """Keep what has reached the file whole, and say once that there will be no more."""
        self.failure = error.strerror or str(error)
        _log.error("nothing is recorded any more in %s: %s", self.path, self.failure)
        self._abandon()
        with suppress(OSError):
            os.truncate(self.path, self._good)

    def _abandon(self) -> None:
        with suppress(OSError):
            self._file.close()


def stamp_of(payload: bytes) -> int | None:
    """The stamp of a message that begins with a std_msgs/Header [ns]; None where it cannot be one."""
    if len(payload) < 12 or payload[0] != 0 or payload[1] > 1:
        return None
    seconds, nanoseconds = (_LITTLE if payload[1] else _BIG).unpack_from(payload, 4)
    return seconds * 10**9 + nanoseconds if seconds >= 0 and nanoseconds < 10**9 else None


def _about(mission: str, text: str, law: str) -> dict[str, str]:
    return {
        "mission": mission,
        "mission_file": text,
        "law": law,
        "recorded_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": sys.version.split()[0],
        **{name: version(name) for name in PACKAGES},
    }


def _why(path: Path, error: OSError) -> str:
    if isinstance(error, FileExistsError):
        reason = "exists already, and a recording is never overwritten"
        return f"--record {path}: {reason if path.exists() else f'{path.parent} is no folder'}"
    return f"--record {path}: cannot be written: {error.strerror}"
