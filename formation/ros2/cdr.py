"""CDR, the encoding of ROS 2's messages: numbers and texts in sequence, each aligned to its size.

Offsets are counted from after the encapsulation, four bytes that give the encoding of the rest. `Writer`
writes little endian; `Reader` reads either byte order and raises BadMessage for bytes that do not fit. Of
a whole library only this much is needed, in a process that must be small and start at once; tests compare
it with that library, byte for byte (docs/decisions/0035).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Self

from formation.wire import BadMessage

LITTLE = b"\0\1\0\0"
MAX_PADDING_BYTES = 3
"""Most bytes that may follow the last field."""
_MAX_FORMATS = 8
"""Number of formats for consecutive float64 fields."""
_MAX_CACHED_BYTES = 256
"""Greatest size of a text that is cached, such as names; longer ones are not [bytes]."""


class _Order(NamedTuple):
    """Encoding of numbers in one byte order."""

    doubles: tuple[struct.Struct, ...]
    """Formats of consecutive float64 fields, by their number."""
    time: struct.Struct
    whole: struct.Struct
    sign: str

    @classmethod
    def of(cls, sign: str) -> Self:
        doubles = tuple(struct.Struct(f"{sign}{number}d") for number in range(_MAX_FORMATS))
        return cls(doubles, struct.Struct(f"{sign}iI"), struct.Struct(f"{sign}I"), sign)


@lru_cache(maxsize=32)
def _singles(sign: str, number: int) -> struct.Struct:
    """Format of consecutive float32 fields in one byte order; a scanner's scans have nearly equal lengths."""
    return struct.Struct(f"{sign}{number}f")


def singles(numbers: Sequence[float]) -> tuple[float, ...]:
    """Round the numbers to float32. Raises BadMessage for numbers that are too large."""
    spelling = _singles("<", len(numbers))
    try:
        return spelling.unpack(spelling.pack(*numbers))
    except OverflowError:
        raise BadMessage("a number is too large for single precision") from None


_LITTLE, _BIG, _OCTET = _Order.of("<"), _Order.of(">"), struct.Struct("B")


class Writer:
    """Bytes of a message, field by field."""

    __slots__ = ("_data",)

    def __init__(self) -> None:
        self._data = bytearray(LITTLE)

    def doubles(self, *numbers: float) -> None:
        """Write consecutive float64 fields."""
        data = self._data
        data += bytes((4 - len(data)) % 8) + _LITTLE.doubles[len(numbers)].pack(*numbers)

    def floats(self, numbers: Sequence[float]) -> None:
        """Write consecutive float32 fields; the numbers are already rounded (`singles`)."""
        self._data += bytes(-len(self._data) % 4) + _singles("<", len(numbers)).pack(*numbers)

    def time(self, seconds: int, nanoseconds: int) -> None:
        """builtin_interfaces/Time."""
        self._data += bytes(-len(self._data) % 4) + _LITTLE.time.pack(seconds, nanoseconds)

    def text(self, text: str) -> None:
        """A string."""
        spelled = _spelled(text) if len(text) <= _MAX_CACHED_BYTES else _encoded(text)
        self._data += bytes(-len(self._data) % 4) + spelled

    def count(self, number: int) -> None:
        """Write a uint32, also the length of a sequence."""
        self._data += bytes(-len(self._data) % 4) + _LITTLE.whole.pack(number)

    def octet(self, number: int) -> None:
        """A uint8."""
        self._data.append(number)

    def zeros(self, numbers: int) -> None:
        """Write that many float64 fields of zero."""
        self._data += bytes((4 - len(self._data)) % 8 + 8 * numbers)

    def written(self) -> bytes:
        """Return the whole message."""
        return bytes(self._data)


class Reader:
    """Fields of a message, in sequence. Methods raise BadMessage if bytes are missing."""

    __slots__ = ("_at", "_data", "_order")

    def __init__(self, data: bytes) -> None:
        # 00, byte order, 00, number of padding bytes at the end of the payload
        if len(data) <= 4 or data[0] or data[1] > 1 or data[2] or data[3] > MAX_PADDING_BYTES:
            raise BadMessage(f"no CDR header but {data[:4].hex(' ') or 'nothing'}")
        self._data, self._at, self._order = data, 4, _LITTLE if data[1] else _BIG

    def doubles(self, number: int) -> tuple[float, ...]:
        """Read that many float64 fields."""
        return self._numbers(self._order.doubles[number], (self._at + 3 & -8) + 4)

    def floats(self, number: int) -> tuple[float, ...]:
        """Read that many float32 fields; the caller has checked the number."""
        return self._numbers(_singles(self._order.sign, number), self._at + 3 & -4)

    def time(self) -> tuple[int, int]:
        """builtin_interfaces/Time: seconds and nanoseconds."""
        seconds, nanoseconds = self._numbers(self._order.time, self._at + 3 & -4)
        return seconds, nanoseconds

    def text(self) -> str:
        """A string, which ends with a zero."""
        size = self.count()
        begin, self._at = self._at, self._at + size
        spelled = self._data[begin : self._at]
        if not size or len(spelled) < size or spelled[-1]:
            raise BadMessage(f"no text of {size} bytes at {begin}")
        return _known(spelled) if size <= _MAX_CACHED_BYTES else _decoded(spelled)

    def count(self) -> int:
        """Read a uint32, also the length of a sequence."""
        return int(self._numbers(self._order.whole, self._at + 3 & -4)[0])

    def octet(self) -> int:
        """A uint8."""
        return int(self._numbers(_OCTET, self._at)[0])

    def skip(self, numbers: int) -> None:
        """Skip that many float64 fields; `end` checks that they exist."""
        self._at = (self._at + 3 & -8) + 4 + 8 * numbers

    def end(self) -> None:
        """Raise BadMessage unless the message ends here, or ended a little before its padding."""
        if not 0 <= len(self._data) - self._at <= MAX_PADDING_BYTES:
            raise BadMessage(f"size mismatch: {len(self._data)} bytes, should be {self._at}")

    def _numbers(self, spelling: struct.Struct, begin: int) -> tuple[Any, ...]:
        self._at = begin + spelling.size
        if self._at > len(self._data):
            raise BadMessage(f"{len(self._data)} bytes, should be at least {self._at}")
        return spelling.unpack_from(self._data, begin)


def _decoded(spelled: bytes) -> str:
    try:
        return spelled[:-1].decode()
    except UnicodeDecodeError:
        raise BadMessage(f"no text but {spelled[:40]!r}") from None


def _encoded(text: str) -> bytes:
    """Length and bytes of a text."""
    spelled = text.encode()
    return _LITTLE.whole.pack(len(spelled) + 1) + spelled + b"\0"


_known, _spelled = lru_cache(maxsize=512)(_decoded), lru_cache(maxsize=512)(_encoded)
