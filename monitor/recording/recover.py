"""Recover a truncated or damaged recording: copy what is readable to a new file with an index and an end."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.records import Chunk as ChunkRecord

from formation.monitor.recording.channels import Channels
from formation.monitor.recording.part import Chunk, Part
from formation.monitor.recording.reader import (
    Condition,
    Extent,
    UnreadableError,
    about_of,
    condition_of,
    extent_of,
)
from formation.monitor.recording.scan import Contents, Progress, Record, contents, declared, parsed, records


class Found(NamedTuple):
    """What is readable in a file, and what is not."""

    condition: Condition
    """What of the file cannot be read."""
    extent: Extent
    """Of what can be read."""
    unreadable: int
    """Incomplete data at its end [bytes]."""

    @property
    def is_whole(self) -> bool:
        """Whether the file has its end and no damage."""
        return not self.condition.words


def recover(
    path: Path, out: Path, checked: Progress = lambda _: None, copied: Progress = lambda _: None
) -> Found:
    """Write what is readable in `path` to `out`, which must not exist; nothing if it is whole already.

    `checked` and `copied` are called with the share of `path` that is.
    Raises UnreadableError if it is no recording, or damaged so that no message can be read; OSError if it
    cannot be read or written. Then there is no `out`.
    """
    about = about_of(path)
    condition = condition_of(path, checked)
    if not condition.words:
        return Found(condition, extent_of(path), 0)
    channels = Channels()
    part = Part(out, {**about, "recovered_from": path.name}, channels)
    try:
        end = _copy(path, part, channels, copied)
        part.finish()
        extent = extent_of(out)
        if condition.damaged and not extent.counts:
            raise UnreadableError(f"{path}: no message can be read: {condition.words}; keep it as it is")
    except BaseException:
        part.discard()
        raise
    return Found(condition, extent, path.stat().st_size - end if condition.is_cut else 0)


def _copy(path: Path, part: Part, channels: Channels, progress: Progress) -> int:
    """Copy every readable chunk unchanged; return where the readable data ends."""
    end, size = 0, max(path.stat().st_size, 1)
    with path.open("rb") as file:
        indexed = list(declared(file))
        for record in records(file):
            end = record.end
            progress(end / size)
            if record.opcode == Opcode.CHUNK and (found := contents(record.body)) is not None:
                _declare(part, channels, found, indexed)
                _append(part, channels, record, found)
    return end


def _declare(part: Part, channels: Channels, found: Contents, indexed: Sequence[Schema | Channel]) -> None:
    """Declare the channels in `indexed` if a chunk that is not readable did so for this one."""
    known = {one.id for one in (*channels.channels, *found.declared)}
    if known.issuperset(message.channel for message in found.messages):
        return
    own = {one.id for one in found.declared}
    for kind in indexed:
        if isinstance(kind, Schema) or kind.id not in own:
            channels.adopt(kind)
    part.append(Chunk(channels=len(channels.channels)))


def _append(part: Part, channels: Channels, record: Record, found: Contents) -> None:
    kinds: list[Schema | Channel] = [*found.schemas, *found.declared]
    for kind in kinds:
        channels.adopt(kind)
    chunk = Chunk(channels=len(channels.channels))
    for message in found.messages:
        chunk.index.setdefault(message.channel, array("Q")).extend((message.logged, message.at))
    times = [message.logged for message in found.messages]
    chunk.start, chunk.end = min(times, default=0), max(times, default=0)
    whole = parsed(ChunkRecord.read, record.body)
    codec = "" if whole is None else whole.compression
    part.append_packed(record.whole, chunk, 0, found.unpacked, codec)
