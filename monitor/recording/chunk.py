"""A chunk of a recording: messages as MCAP lays them out, and the place of each."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field

from mcap.opcode import Opcode

MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length of the rest, channel, sequence, log time, publish time."""
_FIXED_BYTES = MESSAGE.size - 9


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
        raw += MESSAGE.pack(Opcode.MESSAGE, _FIXED_BYTES + len(data), channel, sequence, logged, published)
        raw += data

    def count(self, channel: int) -> int:
        """Return the number of messages of one channel."""
        return len(self.index[channel]) // 2

    @property
    def total(self) -> int:
        """Number of messages of all channels."""
        return sum(map(self.count, self.index))
