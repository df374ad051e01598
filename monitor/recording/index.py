"""Where the chunks of a recording stand, kept small until the end of the file says it.

As MCAP writes it, an hour of a hundred robots is some forty megabytes. Most of that follows from how long
each chunk's message indexes are, which hardly changes from one to the next and packs well.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

BLOCK = 64 * 1024
"""So much of it is packed at a time [bytes]."""
_HEAD = struct.Struct("<QQQQQHH")
_FRONT, _BACK = struct.Struct("<BQQQQQI"), struct.Struct("<QI")
_FIXED = _FRONT.size + _BACK.size + 16
"""Of a ChunkIndex record, besides the name of the codec and its places [bytes]."""
_PLACE = np.dtype([("channel", "<u2"), ("at", "<u8")])


class Entry(NamedTuple):
    """One chunk."""

    start: int
    """Earliest log time [ns]."""
    end: int
    """Latest log time [ns]."""
    offset: int
    """Of its record in the file."""
    length: int
    """Of its record [bytes]."""
    unpacked: int
    """Of what it holds [bytes]."""
    codec: str
    lengths: Mapping[int, int]
    """Of the message indexes that follow it, by channel in their order [bytes]."""

    def record(self, head: int) -> bytes:
        """A ChunkIndex; `head` are the bytes of the chunk's record besides codec and compressed data."""
        channels, lengths = array("H", self.lengths), np.fromiter(self.lengths.values(), np.uint64)
        places = np.empty(len(channels), _PLACE)
        places["channel"], places["at"] = channels, self.offset + self.length + lengths.cumsum() - lengths
        codec, compressed = self.codec.encode(), self.length - head - len(self.codec)
        return b"".join((
            _FRONT.pack(
                Opcode.CHUNK_INDEX, _FIXED - 9 + places.nbytes + len(codec), *self[:4], places.nbytes
            ),
            places.tobytes(),
            _BACK.pack(int(lengths.sum()), len(codec)), codec, struct.pack("<QQ", compressed, self.unpacked),
        ))  # fmt: skip


class Index:
    """All chunks of a file."""

    def __init__(self, head: int) -> None:
        """`head` as `Entry.record` has it."""
        self.count, self.size = 0, 0
        """Chunks, and bytes of what `records` gives."""
        self._head = head
        self._packed: list[bytes] = []
        self._newest = bytearray()

    def add(self, entry: Entry) -> None:
        """One more chunk."""
        codec = entry.codec.encode()
        self.count += 1
        self.size += _FIXED + len(codec) + _PLACE.itemsize * len(entry.lengths)
        numbers = entry[:5]
        self._newest += _HEAD.pack(*numbers, len(codec), len(entry.lengths)) + codec
        self._newest += array("H", entry.lengths).tobytes() + array("I", entry.lengths.values()).tobytes()
        if len(self._newest) >= BLOCK:
            self._packed.append(zlib.compress(self._newest))
            self._newest.clear()

    def records(self) -> bytes:
        """What the summary of the file says of them."""
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
