"""Series in bounded memory: long runs are thinned as they are read, and extremes are kept.

The beginning, in which a formation forms, is kept whole. The rest shares a fixed number of rows: whenever
they are full, each two become one.
"""

from __future__ import annotations

import math
from array import array
from typing import Any, NamedTuple

import numpy as np

from formation.control.arrays import FloatArray

MAX_ROWS = 4096
"""Rows of one series: more than a printed column has dots."""
HEAD_ROWS = 1200
"""Of these, the first ones that are never thinned: a minute of commands at 20 Hz."""
MAX_SAMPLED_VALUES = 1 << 16
"""Number of values from which percentiles are taken."""


class Curves(NamedTuple):
    """Columns over time. A thinned row holds the least and the greatest of its merged rows."""

    time: FloatArray
    """[s]; shape (T,)."""
    low: FloatArray
    """Shape (T, C); NaN where nothing is known."""
    high: FloatArray

    def line(self, column: int) -> tuple[FloatArray, FloatArray]:
        """Return time and values to draw: through the least and the greatest of a merged row."""
        low, high = self.low[:, column], self.high[:, column]
        apart = low < high
        time = np.repeat(self.time, 1 + apart)
        values = np.repeat(low, 1 + apart)
        values[np.cumsum(1 + apart)[apart] - 1] = high[apart]
        return time, values


class _Rows:
    """Times, and rows that a subclass merges."""

    def __init__(self, most: int, head: int) -> None:
        self._most, self._head = most, head
        self._count = 0
        self._stride = 1
        self._pending = 0
        self._time = np.empty(most)

    def _begun(self, time: float) -> bool:
        """Return whether a new row begins at `time` [s]; else the newest one goes on."""
        if self._pending > 0:
            self._pending -= 1
            return False
        if self._count == self._most:
            self._halve()
        self._time[self._count] = time
        self._count += 1
        self._pending = self._stride - 1 if self._count > self._head else 0
        return True

    def _halve(self) -> None:
        """Merge each two rows after the head."""
        pairs = (self._most - self._head) // 2
        into, first = slice(self._head, self._head + pairs), slice(self._head, self._head + 2 * pairs, 2)
        self._time[into] = self._time[first]
        self._merge(into, first, slice(self._head + 1, self._head + 2 * pairs, 2))
        self._count = self._head + pairs
        self._stride *= 2

    def _merge(self, into: slice, first: slice, second: slice) -> None:
        raise NotImplementedError


class Extremes(_Rows):
    """Rows of numbers; a thinned row keeps the least and the greatest of each."""

    def __init__(self, columns: int, most: int = MAX_ROWS, head: int = HEAD_ROWS) -> None:
        super().__init__(most, head)
        self._low, self._high = np.empty((most, columns)), np.empty((most, columns))

    def add(self, time: float, values: Any) -> None:
        """Take one row [time in s]; NaN is: not known."""
        if self._begun(time):
            self._low[self._count - 1] = self._high[self._count - 1] = values
            return
        low, high = self._low[self._count - 1], self._high[self._count - 1]
        np.fmin(low, values, out=low)
        np.fmax(high, values, out=high)

    def curves(self, start: float) -> Curves:
        """Return all rows, in time since `start`."""
        n = self._count
        return Curves(self._time[:n] - start, self._low[:n].copy(), self._high[:n].copy())

    def _merge(self, into: slice, first: slice, second: slice) -> None:
        self._low[into] = np.fmin(self._low[first], self._low[second])
        self._high[into] = np.fmax(self._high[first], self._high[second])


class Samples(_Rows):
    """Rows of vectors (complex); of merged rows the first one stays."""

    def __init__(self, columns: int, most: int = MAX_ROWS, head: int = HEAD_ROWS) -> None:
        super().__init__(most, head)
        self._rows = np.empty((most, columns), dtype=np.complex128)

    def add(self, time: float, values: Any) -> None:
        """Take one row [time in s]; NaN is: not known."""
        if self._begun(time):
            self._rows[self._count - 1] = values

    def taken(self, start: float) -> tuple[FloatArray, Any]:
        """Times since `start` [s], and the rows."""
        return self._time[: self._count] - start, self._rows[: self._count].copy()

    def _merge(self, into: slice, first: slice, second: slice) -> None:  # noqa: ARG002 - the second ones go
        self._rows[into] = self._rows[first]


class Spread:
    """Distribution of a quantity: median and 99th percentile of evenly drawn values, and true extremes."""

    def __init__(self, drawn: int = MAX_SAMPLED_VALUES) -> None:
        self.count = 0
        self.least, self.most = math.inf, -math.inf
        self._drawn, self._stride = drawn, 1
        self._values = array("d")

    def add(self, value: float) -> None:
        """Take one finite value."""
        if self.count % self._stride == 0:
            if len(self._values) == self._drawn:
                self._values = self._values[::2]
                self._stride *= 2
            if self.count % self._stride == 0:
                self._values.append(value)
        self.count += 1
        self.least, self.most = min(self.least, value), max(self.most, value)

    def percentile(self, share: float) -> float | None:
        """Return the value that `share` (0 to 1) of all do not exceed; None without any."""
        if not self._values:
            return None
        ranked = sorted(self._values)
        return ranked[min(math.ceil(share * len(ranked)), len(ranked)) - 1 if share > 0.0 else 0]


class Size:
    """RMS and greatest magnitude of a signal, over all known values."""

    def __init__(self) -> None:
        self.count = 0
        self.greatest = 0.0
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Take one finite value."""
        self.count += 1
        self.greatest = max(self.greatest, abs(value))
        self._squares += value * value

    @property
    def rms(self) -> float | None:
        """Root of the mean square; None without a value."""
        return math.sqrt(self._squares / self.count) if self.count else None

    @property
    def maximum(self) -> float | None:
        """The greatest magnitude; None without a value."""
        return self.greatest if self.count else None
