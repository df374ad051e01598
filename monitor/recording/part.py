"""One file of a recording: MCAP, complete in itself, with all its schemas, channels and metadata.

`mcap`'s own Writer is not used because it keeps everything in memory: for 100 robots an index of some hundred
megabytes an hour as Python objects, and chunks that a full disk refused. Its record classes are used; tests
with three other readers check the format.

<https://mcap.dev/spec>: header, metadata, (chunk, its message indexes)*, end of data, summary, footer.
"""

from __future__ import annotations

import errno
import os
import struct
import threading
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from formation.monitor.recording.channels import ABOUT, Channels
from formation.monitor.recording.scan import MAGIC, MAX_EXPANSION_RATIO, MESSAGE

BLOCK_BYTES = 64 * 1024
"""Size of the index that is compressed at a time [bytes]."""
_HEAD = struct.Struct("<QQQQQHH")
_FRONT, _BACK = struct.Struct("<BQQQQQI"), struct.Struct("<QI")
_FIXED_BYTES = _FRONT.size + _BACK.size + 16
"""Fixed size of a ChunkIndex record, without the codec's name and its places [bytes]."""
_PLACE = np.dtype([("channel", "<u2"), ("at", "<u8")])
PROFILE = "ros2"
CODEC = "lz4"
_CHUNK_HEAD, _CHUNK_LENGTH = struct.Struct("<BQQQQII"), struct.Struct("<Q")
CHUNK_HEAD_BYTES = _CHUNK_HEAD.size + _CHUNK_LENGTH.size
"""Length of a chunk's record without the codec's name and the compressed data [bytes]."""
_INDEX_HEAD = struct.Struct("<BQHI")
_FOOTER_HEAD = struct.Struct("<BQQQ")
_sync = getattr(os, "fdatasync", os.fsync)


@dataclass(slots=True)
class Chunk:
    """Messages in the order of recording. One thread fills it; another writes it once it is handed over."""

    raw: bytearray = field(default_factory=bytearray)
    index: dict[int, array[int]] = field(default_factory=dict)
    """By channel: log time [ns] and offset in `raw`, alternating."""
    start: int = 0
    """Earliest log time [ns]."""
    end: int = 0
    """Latest log time [ns]."""
    channels: int = 0
    """Number of channels when it was handed over."""
    handed: float = 0.0
    """When it was handed over [s, monotonic]."""

    def add(self, channel: int, sequence: int, logged: int, published: int, data: bytes) -> None:
        """Append a message; times in ns."""
        raw, entries = self.raw, self.index.get(channel)
        if entries is None:
            entries = self.index[channel] = array("Q")
        if not raw:
            self.start = self.end = logged
        elif logged > self.end:
            self.end = logged
        elif logged < self.start:
            self.start = logged
        entries.append(logged)
        entries.append(len(raw))
        raw += MESSAGE.pack(
            Opcode.MESSAGE, MESSAGE.size - 9 + len(data), channel, sequence, logged, published
        )
        raw += data

    def count(self, channel: int) -> int:
        """Return the number of messages of one channel."""
        return len(self.index[channel]) // 2

    @property
    def total(self) -> int:
        """Number of messages of all channels."""
        return sum(map(self.count, self.index))


class ChunkEntry(NamedTuple):
    """One chunk."""

    start: int
    """Earliest log time [ns]."""
    end: int
    """Latest log time [ns]."""
    offset: int
    """Offset of its record in the file [bytes]."""
    length: int
    """Length of its record [bytes]."""
    unpacked: int
    """Uncompressed length of its content [bytes]."""
    codec: str
    lengths: Mapping[int, int]
    """Lengths of the message indexes that follow it, by channel in their order [bytes]."""

    def record(self) -> bytes:
        """Return a ChunkIndex."""
        channels, lengths = array("H", self.lengths), np.fromiter(self.lengths.values(), np.uint64)
        places = np.empty(len(channels), _PLACE)
        places["channel"], places["at"] = channels, self.offset + self.length + lengths.cumsum() - lengths
        codec, compressed = self.codec.encode(), self.length - CHUNK_HEAD_BYTES - len(self.codec)
        return b"".join((
            _FRONT.pack(
                Opcode.CHUNK_INDEX, _FIXED_BYTES - 9 + places.nbytes + len(codec), *self[:4], places.nbytes
            ),
            places.tobytes(),
            _BACK.pack(int(lengths.sum()), len(codec)), codec, struct.pack("<QQ", compressed, self.unpacked),
        ))  # fmt: skip


class Index:
    """All chunks of a file, kept compressed until they are written at its end.

    In MCAP's form, an hour of a hundred robots takes some forty megabytes. Most of that is the lengths of
    each chunk's message indexes, which hardly change from one to the next and compress well.
    """

    def __init__(self) -> None:
        self.count, self.size = 0, 0
        """Number of chunks, and length of `records()` [bytes]."""
        self._packed: list[bytes] = []
        self._newest = bytearray()

    def add(self, entry: ChunkEntry) -> None:
        """Add a chunk."""
        codec = entry.codec.encode()
        self.count += 1
        self.size += _FIXED_BYTES + len(codec) + _PLACE.itemsize * len(entry.lengths)
        numbers = entry[:5]
        self._newest += _HEAD.pack(*numbers, len(codec), len(entry.lengths)) + codec
        self._newest += array("H", entry.lengths).tobytes() + array("I", entry.lengths.values()).tobytes()
        if len(self._newest) >= BLOCK_BYTES:
            self._packed.append(zlib.compress(self._newest))
            self._newest.clear()

    def records(self) -> bytes:
        """Return the chunk records of the file's summary."""
        return b"".join(entry.record() for entry in self._entries())

    def _entries(self) -> Iterator[ChunkEntry]:
        for block in (*map(zlib.decompress, self._packed), bytes(self._newest)):
            at = 0
            while at < len(block):
                start, end, offset, length, unpacked, name, count = _HEAD.unpack_from(block, at)
                at += _HEAD.size
                codec, channels, lengths = block[at : at + name].decode(), array("H"), array("I")
                at += name
                channels.frombytes(block[at : at + 2 * count])
                lengths.frombytes(block[at + 2 * count : at + 6 * count])
                at += 6 * count
                places = dict(zip(channels, lengths, strict=True))
                yield ChunkEntry(start, end, offset, length, unpacked, codec, places)


class Part:
    """A file being written. A failure raises OSError and leaves the file as it was before."""

    def __init__(self, path: Path, about: Mapping[str, str], channels: Channels) -> None:
        """Create `path`, which must not exist, and force its folder entry to the disk."""
        self.path = path
        self.counts: Counter[int] = Counter()
        """Number of messages by channel."""
        self.start, self.end = 0, 0
        """Log times of the first and the last message [ns]."""
        self._channels, self._declared = channels, 0
        self._forcing = threading.Lock()
        self._index = Index()
        self._known, self._kinds_size = 0, 0
        fresh = _make_folder(path.parent)
        self._file = path.open("xb", buffering=0)
        try:
            top = MAGIC + encoded(Header(profile=PROFILE, library=f"formation {version('zenoh-formation')}"))
            metadata = encoded(Metadata(name=ABOUT, metadata=dict(about)))
            self._metadata = MetadataIndex(offset=len(top), length=len(metadata), name=ABOUT)
            self._write(top + metadata)
            self.size = len(top) + len(metadata)
            os.fsync(self._file.fileno())
            for folder in fresh:
                _sync_folder(folder)
        except OSError:
            self.discard()
            raise

    @property
    def is_gone(self) -> bool:
        """Return whether the file was deleted."""
        return os.fstat(self._file.fileno()).st_nlink == 0

    @property
    def whole_size(self) -> int:
        """Approximate size if it ended now [bytes]."""
        return self.size + self.summary_size

    @property
    def summary_size(self) -> int:
        """Approximate size of the index at the end if it ended now [bytes]."""
        if self._known != len(self._channels.channels):
            self._known = len(self._channels.channels)
            kinds = (*self._channels.schemas, *self._channels.channels)
            self._kinds_size = sum(len(encoded(one)) for one in kinds)
        return self._kinds_size + self._index.size + 10 * self._known + 1000

    def append(self, chunk: Chunk) -> None:
        """Write a chunk to the operating system."""
        declarations = self._declarations(chunk.channels)
        raw = declarations + chunk.raw
        record, codec = _chunk_record(chunk, raw)
        self.append_packed(record, chunk, len(declarations), len(raw), codec)

    def append_packed(self, record: bytes, chunk: Chunk, shift: int, unpacked: int, codec: str) -> None:
        """Write a chunk's whole record, and the indexes of its messages.

        `chunk` describes the messages; in the record they stand `shift` bytes further back, and `unpacked` is
        its length in bytes before compression by `codec`.
        """
        lengths, indexes = {}, bytearray()
        for channel, entries in chunk.index.items():
            table = np.array(entries, dtype="<u8")
            table[1::2] += shift
            length = table.nbytes
            lengths[channel] = _INDEX_HEAD.size + length
            indexes += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + length, channel, length) + table.tobytes()
        self._write(record + indexes)
        self._index.add(ChunkEntry(chunk.start, chunk.end, self.size, len(record), unpacked, codec, lengths))
        self.size += len(record) + len(indexes)
        self._declared = chunk.channels
        if chunk.index:
            self.start = min(self.start, chunk.start) if self.counts else chunk.start
            self.end = max(self.end, chunk.end)
        for channel in chunk.index:
            self.counts[channel] += chunk.count(channel)

    def sync(self) -> None:
        """Force it to the disk unless it has ended; return when done. For a separate thread."""
        with self._forcing:
            if not self._file.closed:
                _sync(self._file.fileno())

    def finish(self) -> None:
        """Write the index and close the file, also if writing fails."""
        try:
            late = self._declarations(len(self._channels.channels))
            self._write(late + encoded(DataEnd(data_section_crc=0)) + self._summary(self.size + len(late)))
            os.fsync(self._file.fileno())
        finally:
            self._close()

    def discard(self) -> None:
        """Close and delete the file."""
        self._close()
        self.path.unlink(missing_ok=True)

    def reserve(self, room: int) -> None:
        """Raise OSError unless `room` more bytes can be written: only this shows a quota."""
        try:
            os.posix_fallocate(self._file.fileno(), self.size, room)
        finally:
            self._file.truncate(self.size)

    def _close(self) -> None:
        with self._forcing:
            self._file.close()

    def _write(self, data: bytes | bytearray) -> None:
        """Append all of `data`, or nothing."""
        before, view = self._file.tell(), memoryview(data)
        try:
            while view:
                done = self._file.write(view)
                if not done:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
                view = view[done:]
        except OSError:
            self._file.seek(before)
            self._file.truncate()
            raise

    def _declarations(self, count: int) -> bytes:
        """Return the channels that are new to this file, with their schemas."""
        new = self._channels.channels[self._declared : count]
        known = {one.schema_id for one in self._channels.channels[: self._declared]} if new else set()
        schemas = {one.id: one for one in self._channels.schemas} if new else {}
        records = bytearray()
        for channel in new:
            if channel.schema_id not in known:
                known.add(channel.schema_id)
                if channel.schema_id in schemas:
                    records += encoded(schemas[channel.schema_id])
            records += encoded(channel)
        return bytes(records)

    def _summary(self, end: int) -> bytes:
        """Return everything after the data, which ends at `end`."""
        base = end + len(encoded(DataEnd(data_section_crc=0)))
        groups = (
            (Opcode.SCHEMA, b"".join(map(encoded, self._channels.schemas))),
            (Opcode.CHANNEL, b"".join(map(encoded, self._channels.channels))),
            (Opcode.STATISTICS, encoded(self._statistics())),
            (Opcode.CHUNK_INDEX, self._index.records()),
            (Opcode.METADATA_INDEX, encoded(self._metadata)),
        )
        body, offsets = bytearray(), b""
        for opcode, records in groups:
            if records:
                start = base + len(body)
                offsets += encoded(SummaryOffset(opcode, start, len(records)))
                body += records
        places = base, base + len(body)
        body += offsets
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, 20, *places)
        return bytes(body) + encoded(Footer(*places, summary_crc=zlib.crc32(head, zlib.crc32(body)))) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            message_count=self.counts.total(), schema_count=len(self._channels.schemas),
            channel_count=len(self._channels.channels), attachment_count=0, metadata_count=1,
            chunk_count=self._index.count, message_start_time=self.start, message_end_time=self.end,
            channel_message_counts=dict(self.counts),
        )  # fmt: skip


def encoded(record: McapRecord) -> bytes:
    """Return one record as stored in the file."""
    builder = RecordBuilder()
    write: Callable[[RecordBuilder], None] = record.write
    write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _chunk_record(chunk: Chunk, raw: bytes) -> tuple[bytes, str]:
    """Return a Chunk and its codec: none where readers would refuse what is packed so well."""
    data, codec = lz4.frame.compress(raw), CODEC
    if len(raw) > MAX_EXPANSION_RATIO * len(data):
        data, codec = raw, ""
    name = codec.encode()
    length = CHUNK_HEAD_BYTES - 9 + len(name) + len(data)
    head = chunk.start, chunk.end, len(raw), zlib.crc32(raw), len(name)
    packed_data = name, _CHUNK_LENGTH.pack(len(data)), data
    return b"".join((_CHUNK_HEAD.pack(Opcode.CHUNK, length, *head), *packed_data)), codec


def _make_folder(folder: Path) -> list[Path]:
    """Make the folder and missing parents; return every folder with a new entry."""
    changed = [folder]
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
        changed.append(folder)
    changed[0].mkdir(parents=True, exist_ok=True)
    return changed


def _sync_folder(folder: Path) -> None:
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
