"""The places of a recording's chunks, kept compressed until they are written at the end of the file.

In MCAP's form, an hour of a hundred robots takes some forty megabytes. Most of that is the lengths of each
chunk's message indexes, which hardly change from one to the next and compress well.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

BLOCK_BYTES = 64 * 1024
"""Size compressed at a time [bytes]."""
_HEAD = struct.Struct("<QQQQQHH")
_FRONT, _BACK = struct.Struct("<BQQQQQI"), struct.Struct("<QI")
_FIXED_BYTES = _FRONT.size + _BACK.size + 16
"""Fixed size of a ChunkIndex record, without the codec's name and its places [bytes]."""
_PLACE = np.dtype([("channel", "<u2"), ("at", "<u8")])


class Entry(NamedTuple):
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

    def record(self, head: int) -> bytes:
        """Return a ChunkIndex; `head`: bytes of the chunk's record besides codec and compressed data."""
        channels, lengths = array("H", self.lengths), np.fromiter(self.lengths.values(), np.uint64)
        places = np.empty(len(channels), _PLACE)
        places["channel"], places["at"] = channels, self.offset + self.length + lengths.cumsum() - lengths
        codec, compressed = self.codec.encode(), self.length - head - len(self.codec)
        return b"".join((
            _FRONT.pack(
                Opcode.CHUNK_INDEX, _FIXED_BYTES - 9 + places.nbytes + len(codec), *self[:4], places.nbytes
            ),
            places.tobytes(),
            _BACK.pack(int(lengths.sum()), len(codec)), codec, struct.pack("<QQ", compressed, self.unpacked),
        ))  # fmt: skip


class Index:
    """All chunks of a file."""

    def __init__(self, head: int) -> None:
        """`head` as in `Entry.record`."""
        self.count, self.size = 0, 0
        """Number of chunks, and length of `records()` [bytes]."""
        self._head = head
        self._packed: list[bytes] = []
        self._newest = bytearray()

    def add(self, entry: Entry) -> None:
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
        return b"".join(entry.record(self._head) for entry in self._entries())

    def _entries(self) -> Iterator[Entry]:
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
                yield Entry(start, end, offset, length, unpacked, codec, places)
