"""What is recorded in one go: messages as MCAP lays them out in a chunk, and where in it each stands."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field

from mcap.opcode import Opcode

MESSAGE = struct.Struct("<BQHIQQ")
"""Before the data of a message: opcode, length of what follows, channel, sequence, log time, publish time."""
_FIXED = MESSAGE.size - 9


@dataclass(slots=True)
class Chunk:
    """Messages in the order of recording. One thread fills it; once handed over another one writes it."""

    raw: bytearray = field(default_factory=bytearray)
    index: dict[int, array[int]] = field(default_factory=dict)
    """By channel: log time [ns] and offset in `raw`, in turns."""
    start: int = 0
    """Earliest log time [ns]."""
    end: int = 0
    """Latest log time [ns]."""
    channels: int = 0
    """How many there were when it was handed over."""
    handed: float = 0.0
    """When that was [s, monotonic]."""

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
        raw += MESSAGE.pack(Opcode.MESSAGE, _FIXED + len(data), channel, sequence, logged, published)
        raw += data

    def count(self, channel: int) -> int:
        """Messages of one channel."""
        return len(self.index[channel]) // 2

    @property
    def total(self) -> int:
        """Messages of all channels."""
        return sum(map(self.count, self.index))
