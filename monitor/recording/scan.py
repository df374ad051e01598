"""Read what is readable of a truncated or damaged MCAP file. No content raises an exception.

`mcap`'s readers raise if the index is missing, and build an object for each message.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from io import BytesIO
from types import MappingProxyType
from typing import IO, NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Schema

MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length of the rest, channel, sequence, log time, publish time."""
MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 64 * 1024 * 1024
"""Longest record that is read [bytes]. The recorder's own are chunks of a megabyte and one message."""
MAX_CHUNK_BYTES = 16 * 1024 * 1024
"""Longest chunk that is read, unpacked [bytes]. The recorder's own have a megabyte and one message of 8 MB at
most; other tools that rewrite a recording make chunks of 4 MB. Reading takes ten times as much memory."""
MAX_EXPANSION_RATIO = 100
"""Largest ratio of a chunk's length to that of its packed form. The recorder does not pack what exceeds it.
A file made to keep its reader busy packs zeros 10,000 times; with this bound the time to read a file is
proportional to its size."""
MAX_SUMMARY_BYTES = 256 * 1024 * 1024
"""Longest index that is read [bytes]. An hour of a hundred robots has some forty megabytes."""
_HEAD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")  # of the first and the last message of a chunk [ns]
_CHUNK_PLACE = struct.Struct("<QQQ")  # of a chunk's index: first and last message [ns], its offset [bytes]
_FOOTER = _HEAD.size + 20
_SUMMARY_CRC_BYTES = 4
_KINDS: Mapping[int, type[Schema | Channel]] = MappingProxyType(
    {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
)
R = TypeVar("R")
Progress = Callable[[float], None]
"""Progress callback: the share of the file read, from 0 to 1."""


class Record(NamedTuple):
    """One record of a file."""

    opcode: int
    at: int
    """Its offset [bytes from the file's start]."""
    body: bytes
    """The bytes after its length field."""

    @property
    def whole(self) -> bytes:
        """The whole record as stored in the file."""
        return _HEAD.pack(self.opcode, len(self.body)) + self.body

    @property
    def end(self) -> int:
        """Offset of the next record [bytes]."""
        return self.at + _HEAD.size + len(self.body)


class Times(NamedTuple):
    """When a chunk's messages arrived, each [ns]."""

    first: int
    last: int


class ChunkMessage(NamedTuple):
    """One message of a chunk."""

    channel: int
    logged: int
    """[ns]"""
    at: int
    """Its offset in the unpacked chunk [bytes]."""
    data: bytes


class Contents(NamedTuple):
    """The content of a chunk."""

    declared: list[Channel]
    schemas: list[Schema]
    messages: list[ChunkMessage]
    unpacked: int
    """Length of the unpacked chunk [bytes]."""


def first_records(file: IO[bytes]) -> Iterator[Record]:
    """Yield every whole record from the start of `file`, up to the footer or the first invalid one."""
    file.seek(0)
    if file.read(len(MAGIC)) == MAGIC:
        yield from _records_from(file, len(MAGIC))


def records(file: IO[bytes]) -> Iterator[Record]:
    """Yield every whole record from the start of `file`, up to the footer.

    After an invalid record it goes on at the next chunk in the index, and ends if there is none. What cannot
    be read is a gap between the end of a record and the offset of the next.
    """
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        return
    starts = _chunk_starts(file)
    at = len(MAGIC)
    while True:
        for record in _records_from(file, at, starts):
            yield record
            if record.opcode == Opcode.FOOTER:
                return
            at = record.end
        following = bisect_right(starts, at)
        if following == len(starts):
            return
        at = starts[following]


def damaged(file: IO[bytes], on_progress: Progress) -> int:
    """Return the number of stretches that cannot be read; what is missing at the end is none."""
    count, end, size = 0, len(MAGIC), os.fstat(file.fileno()).st_size
    for record in records(file):
        on_progress(record.end / size)
        unreadable = record.opcode == Opcode.CHUNK and contents(record.body) is None
        count += (record.at != end) + unreadable
        end = record.end
        if record.opcode == Opcode.FOOTER:
            return count + (not _is_summary_intact(file))
    return count + (footer(file) is not None)


def parsed(read: Callable[[ReadDataStream], R], body: bytes) -> R | None:
    """Return a record parsed by its class's `read`; None if it is damaged."""
    try:
        return read(ReadDataStream(BytesIO(body)))
    except (McapError, ValueError, OverflowError, struct.error):
        return None


def contents(body: bytes) -> Contents | None:
    """Return the content of the chunk with this body; None if any of it is damaged."""
    chunk = parsed(Chunk.read, body)
    try:
        if chunk is None:
            return None
        raw = _unpacked(chunk)
        if len(raw) != chunk.uncompressed_size or chunk.uncompressed_crc not in {0, zlib.crc32(raw)}:
            return None
        return _contents(raw)
    except (zstandard.ZstdError, ValueError, RuntimeError, MemoryError, EOFError, struct.error):
        return None


def times_of(chunk: Record) -> Times | None:
    """Return the times of a chunk, or of a chunk in the index; None if it is damaged."""
    return Times(*_TIMES.unpack_from(chunk.body)) if len(chunk.body) >= _TIMES.size else None


def ends_before(chunk: Record, moment: float) -> bool:
    """Return whether all messages of a chunk arrived before `moment` [s]; False if it is damaged."""
    times = times_of(chunk)
    return times is not None and times.last < moment * 1e9


def footer(file: IO[bytes]) -> Footer | None:
    """Return the footer of a whole file; None if it is missing or points outside the file."""
    size = os.fstat(file.fileno()).st_size
    if size < 2 * len(MAGIC) + _FOOTER:
        return None
    file.seek(size - _FOOTER - len(MAGIC))
    tail = file.read()
    if not tail.endswith(MAGIC) or _HEAD.unpack_from(tail) != (Opcode.FOOTER, 20):
        return None
    found = parsed(Footer.read, tail[_HEAD.size :])
    inside = found is not None and (not found.summary_start or len(MAGIC) <= found.summary_start < size)
    return found if inside else None


def summary(file: IO[bytes]) -> Iterator[Record]:
    """Yield the records of the index at the end, if there is one and it is not damaged."""
    end = footer(file)
    if end is not None and end.summary_start and _is_summary_intact(file):
        yield from _records_from(file, end.summary_start)


def declared(file: IO[bytes]) -> Iterator[Schema | Channel]:
    """Yield the schemas and channels in the index, schemas first."""
    for record in summary(file):
        kind = _KINDS.get(record.opcode)
        found = None if kind is None else parsed(kind.read, record.body)
        if found is not None:
            yield found


def _is_summary_intact(file: IO[bytes]) -> bool:
    """Return whether the index has its checksum, or none is stated."""
    end = footer(file)
    if end is None or not end.summary_start or not end.summary_crc:
        return True
    length = os.fstat(file.fileno()).st_size - end.summary_start - len(MAGIC) - _SUMMARY_CRC_BYTES
    if length > MAX_SUMMARY_BYTES:
        return False
    file.seek(end.summary_start)
    return zlib.crc32(file.read(length)) == end.summary_crc


def _chunk_starts(file: IO[bytes]) -> Sequence[int]:
    """Return the offsets of all chunks and of the index itself, in order; empty unless its checksum holds."""
    end = footer(file)
    if end is None or not end.summary_crc:
        return ()
    heads = (
        record.body[: _CHUNK_PLACE.size] for record in summary(file) if record.opcode == Opcode.CHUNK_INDEX
    )
    chunks = array("Q", (_CHUNK_PLACE.unpack(head)[2] for head in heads if len(head) == _CHUNK_PLACE.size))
    return array("Q", sorted({*chunks, end.summary_start})) if chunks else ()


def _records_from(file: IO[bytes], at: int, starts: Sequence[int] = ()) -> Iterator[Record]:
    """Yield every whole record from `at` on, the footer included, up to an invalid record.

    No record reaches over an offset in `starts`, which are sorted.
    """
    size = os.fstat(file.fileno()).st_size
    file.seek(at)
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
        following = bisect_right(starts, at)
        end = starts[following] if following < len(starts) else size
        if opcode == 0 or length > min(MAX_RECORD_BYTES, end - at - _HEAD.size):
            return
        body = file.read(length)
        if len(body) < length:
            return
        yield Record(opcode, at, body)
        at += _HEAD.size + length
        if opcode == Opcode.FOOTER:
            return


def _unpacked(chunk: Chunk) -> bytes:
    """Return its records, at most a byte more than stated. Raises the codec's errors, or ValueError."""
    size = chunk.uncompressed_size
    if size > min(MAX_CHUNK_BYTES, MAX_EXPANSION_RATIO * len(chunk.data)):
        raise ValueError(f"a chunk of {size} bytes in {len(chunk.data)} is longer than any that is read")
    match chunk.compression:
        case "":
            return chunk.data
        case "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1))
        case "zstd":
            return zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    raise ValueError(f"a chunk is packed by {chunk.compression[:20]!r}: must be lz4, zstd or nothing")


def _contents(raw: bytes) -> Contents:
    """Parse the records in `raw`. Raises ValueError or struct.error if it is no sequence of records."""
    found = Contents([], [], [], len(raw))
    message = int(Opcode.MESSAGE)  # of which there are thousands
    at = 0
    while at < len(raw):
        opcode, length = _HEAD.unpack_from(raw, at)
        end = at + _HEAD.size + length
        if opcode == 0 or end > len(raw):
            raise ValueError("no record, or one that is longer than its chunk")
        if opcode == message:
            _, _, channel, _, logged, _ = MESSAGE.unpack_from(raw, at)
            found.messages.append(ChunkMessage(channel, logged, at, raw[at + MESSAGE.size : end]))
        elif opcode == Opcode.CHANNEL:
            found.declared.append(_parsed_or_raise(Channel.read, raw[at + _HEAD.size : end]))
        elif opcode == Opcode.SCHEMA:
            found.schemas.append(_parsed_or_raise(Schema.read, raw[at + _HEAD.size : end]))
        at = end
    return found


def _parsed_or_raise(read: Callable[[ReadDataStream], R], body: bytes) -> R:
    record = parsed(read, body)
    if record is None:
        raise ValueError("a record of a chunk is damaged")
    return record
