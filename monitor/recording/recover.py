"""Recover a truncated recording: copy what is readable to a new file with an index and an end."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.records import Chunk as ChunkRecord

from formation.monitor.recording.channels import Channels
from formation.monitor.recording.part import Chunk, Part
from formation.monitor.recording.reader import Extent, about_of, extent_of
from formation.monitor.recording.scan import Contents, Record, contents, footer, records, understood

Tell = Callable[[float], None]
"""Progress callback: the share of the file read, from 0 to 1."""


class Found(NamedTuple):
    """What is readable in a file, and what is not."""

    is_whole: bool
    """Whether it has its end and no damage."""
    extent: Extent
    unreadable: int
    """Incomplete data at its end [bytes]."""
    damaged: int
    """Number of stretches that cannot be read."""


def recover(path: Path, out: Path, tell: Tell = lambda _: None) -> Found:
    """Write what is readable in `path` to `out`, which must not exist; nothing if it is whole already.

    Raises UnreadableError if it is no recording, OSError if it cannot be read or written; then there is no
    `out`.
    """
    about = about_of(path)
    whole = _examine(path, tell)
    if whole is not None:
        return whole
    channels = Channels()
    part = Part(out, {**about, "recovered_from": path.name}, channels)
    try:
        damaged, end = _copy(path, part, channels, tell)
        part.finish()
    except BaseException:
        part.discard()
        raise
    return Found(False, extent_of(out), path.stat().st_size - end, damaged)


def _examine(path: Path, tell: Tell) -> Found | None:
    """Return None unless the file is whole; only one with an end is read for that."""
    with path.open("rb") as file:
        if footer(file) is None:
            return None
        size = path.stat().st_size
        for record in records(file):
            tell(record.end / size)
            if record.opcode == Opcode.CHUNK and contents(record.body) is None:
                return None
            if record.opcode == Opcode.FOOTER:
                return Found(True, extent_of(path), 0, 0)
    return None


def _copy(path: Path, part: Part, channels: Channels, tell: Tell) -> tuple[int, int]:
    """Copy chunk by chunk, unchanged; return the number of failures, and where the readable data ends."""
    damaged, end, size = 0, 0, max(path.stat().st_size, 1)
    with path.open("rb") as file:
        for record in records(file):
            tell(record.end / size)
            end = size if record.opcode == Opcode.FOOTER else record.end
            if record.opcode != Opcode.CHUNK:
                continue
            found = contents(record.body)
            if found is None:
                damaged += 1
            else:
                _append(part, channels, record, found)
    return damaged, end


def _append(part: Part, channels: Channels, record: Record, found: Contents) -> None:
    kinds: list[Schema | Channel] = [*found.schemas, *found.declared]
    for kind in kinds:
        channels.adopt(kind)
    chunk = Chunk(channels=len(channels.channels))
    for message in found.messages:
        chunk.index.setdefault(message.channel, array("Q")).extend((message.logged, message.at))
    times = [message.logged for message in found.messages]
    chunk.start, chunk.end = min(times, default=0), max(times, default=0)
    whole = understood(ChunkRecord.read, record.body)
    codec = "" if whole is None else whole.compression
    part.append_packed(record.whole, chunk, 0, found.unpacked, codec)
