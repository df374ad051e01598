"""Read an MCAP file up to where it is truncated or damaged. No content raises an exception.

`mcap`'s readers raise if the index is missing, and build an object for each message.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
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
"""Longest chunk that is read, unpacked [bytes]. The recorder's own have a megabyte and one message; other
tools that rewrite a recording make chunks of 4 MB. Reading one takes some ten times as much memory."""
MAX_EXPANSION_RATIO = 100
"""Largest ratio of a chunk's length to that of its packed form. The recorder's own chunks reach 10. A file
made to keep its reader busy packs zeros 10,000 times; with this bound the time to read a file is
proportional to its size."""
_HEAD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")  # of the first and the last message of a chunk [ns]
_FOOTER = _HEAD.size + 20
R = TypeVar("R")


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


class Entry(NamedTuple):
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
    messages: list[Entry]
    unpacked: int
    """Length of the unpacked chunk [bytes]."""


def records(file: IO[bytes]) -> Iterator[Record]:
    """Yield every whole record from the start of `file`, up to the footer or an invalid record."""
    file.seek(0)
    if file.read(len(MAGIC)) == MAGIC:
        yield from _records_from(file, len(MAGIC))


def understood(read: Callable[[ReadDataStream], R], body: bytes) -> R | None:
    """Return a record parsed by its class's `read`; None if it is damaged."""
    try:
        return read(ReadDataStream(BytesIO(body)))
    except (McapError, ValueError, OverflowError, struct.error):
        return None


def contents(body: bytes) -> Contents | None:
    """Return the content of the chunk with this body; None if any of it is damaged."""
    chunk = understood(Chunk.read, body)
    try:
        if chunk is None:
            return None
        raw = _unpacked(chunk)
        if len(raw) != chunk.uncompressed_size or chunk.uncompressed_crc not in {0, zlib.crc32(raw)}:
            return None
        return _contents(raw)
    except (zstandard.ZstdError, ValueError, RuntimeError, MemoryError, EOFError, struct.error):
        return None


def ends_before(chunk: Record, moment: float) -> bool:
    """Return whether all messages of a chunk arrived before `moment` [s]; False if it is damaged."""
    return len(chunk.body) >= _TIMES.size and _TIMES.unpack_from(chunk.body)[1] < moment * 1e9


def footer(file: IO[bytes]) -> Footer | None:
    """Return the footer of a whole file; None if it is missing or points outside the file."""
    size = os.fstat(file.fileno()).st_size
    if size < 2 * len(MAGIC) + _FOOTER:
        return None
    file.seek(size - _FOOTER - len(MAGIC))
    tail = file.read()
    if not tail.endswith(MAGIC) or _HEAD.unpack_from(tail) != (Opcode.FOOTER, 20):
        return None
    found = understood(Footer.read, tail[_HEAD.size :])
    inside = found is not None and (not found.summary_start or len(MAGIC) <= found.summary_start < size)
    return found if inside else None


def summary(file: IO[bytes]) -> Iterator[Record]:
    """Yield the records of the index at the end, if there is one."""
    end = footer(file)
    if end is not None and end.summary_start:
        yield from _records_from(file, end.summary_start)


def _records_from(file: IO[bytes], at: int) -> Iterator[Record]:
    """Yield every whole record from `at` on, the footer included, up to an invalid record."""
    end = os.fstat(file.fileno()).st_size
    file.seek(at)
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
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
            found.messages.append(Entry(channel, logged, at, raw[at + MESSAGE.size : end]))
        elif opcode == Opcode.CHANNEL:
            found.declared.append(_sure(Channel.read, raw[at + _HEAD.size : end]))
        elif opcode == Opcode.SCHEMA:
            found.schemas.append(_sure(Schema.read, raw[at + _HEAD.size : end]))
        at = end
    return found


def _sure(read: Callable[[ReadDataStream], R], body: bytes) -> R:
    record = understood(read, body)
    if record is None:
        raise ValueError("a record of a chunk is damaged")
    return record
