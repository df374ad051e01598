"""Series and statistics in bounded memory: long runs are thinned as they are read, and extremes are kept.

The beginning, in which a formation forms, is kept whole. The rest shares a fixed number of rows: whenever
they are full, each two become one.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from formation.control.arrays import FloatArray
from formation.mission.model import Mission
from formation.monitor.metrics.snapshot import SATURATED_SHARE
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.wire import BadMessage

Merge = Callable[[Any, Any], Any]
MAX_ROWS = 4096
"""Rows of one series: more than a printed column has dots."""
HEAD_ROWS = 1200
"""Of these, the first ones that are never thinned: a minute of commands at 20 Hz."""
MAX_SAMPLED_VALUES = 1 << 16
"""Number of values from which percentiles are taken."""
MAX_LINE_GAP = 1.0
"""Longest silence across which a line is drawn [s]."""


class Curves(NamedTuple):
    """Columns over time. A thinned row holds the least and the greatest of its merged rows."""

    time: FloatArray
    """[s]; shape (T,)."""
    low: FloatArray
    """Shape (T, C); NaN where nothing is known."""
    high: FloatArray

    def until(self, end: float) -> FloatArray:
        """Return the least and the greatest values of all rows from 0 to `end` [s]; shape (2 T, C)."""
        shown = (self.time >= 0.0) & (self.time <= end)
        return np.concatenate([self.low[shown], self.high[shown]])

    def line(self, column: int) -> tuple[FloatArray, FloatArray]:
        """Return time and values to draw: through the least and the greatest of a merged row."""
        low, high = self.low[:, column], self.high[:, column]
        apart = low < high
        time = np.repeat(self.time, 1 + apart)
        values = np.repeat(low, 1 + apart)
        values[np.cumsum(1 + apart)[apart] - 1] = high[apart]
        return time, values


class _Rows:
    """Times, and rows of values; of two rows that become one, each of `merges` keeps something."""

    merges: tuple[Merge, ...]
    dtype: type

    def __init__(self, columns: int, max_rows: int = MAX_ROWS, head: int = HEAD_ROWS) -> None:
        self._max_rows, self._head = max_rows, head
        self._count, self._stride, self._pending = 0, 1, 0
        self._time = np.empty(max_rows)
        self._rows: list[Any] = [np.empty((max_rows, columns), self.dtype) for _ in self.merges]

    def add(self, time: float, values: Any) -> None:
        """Take one row [time in s]; NaN for unknown values."""
        if self._pending > 0:
            self._pending -= 1
            for rows, merge in zip(self._rows, self.merges, strict=True):
                rows[self._count - 1] = merge(rows[self._count - 1], values)
            return
        if self._count == self._max_rows:
            self._halve()
        self._time[self._count] = time
        for rows in self._rows:
            rows[self._count] = values
        self._count += 1
        self._pending = self._stride - 1 if self._count > self._head else 0

    def _halve(self) -> None:
        """Merge each two rows after the head."""
        pairs = (self._max_rows - self._head) // 2
        into, first = slice(self._head, self._head + pairs), slice(self._head, self._head + 2 * pairs, 2)
        second = slice(self._head + 1, self._head + 2 * pairs, 2)
        self._time[into] = self._time[first]
        for rows, merge in zip(self._rows, self.merges, strict=True):
            rows[into] = merge(rows[first], rows[second])
        self._count = self._head + pairs
        self._stride *= 2


class Extremes(_Rows):
    """Rows of numbers; a thinned row keeps the least and the greatest of each."""

    merges, dtype = (np.fmin, np.fmax), np.float64

    def curves(self, start: float) -> Curves:
        """Return all rows, in time since `start`."""
        low, high = (rows[: self._count].copy() for rows in self._rows)
        return Curves(self._time[: self._count] - start, low, high)


class Samples(_Rows):
    """Rows of vectors (complex); of merged rows the first one stays."""

    merges, dtype = (lambda first, _second: first,), np.complex128

    def rows(self, start: float) -> tuple[FloatArray, Any]:
        """Return the times since `start` [s], and the rows."""
        return self._time[: self._count] - start, self._rows[0][: self._count].copy()


class Quantiles:
    """Distribution of a quantity: percentiles of evenly drawn values, and the true maximum."""

    def __init__(self, max_values: int = MAX_SAMPLED_VALUES) -> None:
        self.count = 0
        self.maximum = -math.inf
        self._max_values, self._stride = max_values, 1
        self._values = array("d")

    def add(self, value: float) -> None:
        """Take one finite value."""
        if self.count % self._stride == 0:
            if len(self._values) == self._max_values:
                self._values = self._values[::2]
                self._stride *= 2
            if self.count % self._stride == 0:
                self._values.append(value)
        self.count += 1
        self.maximum = max(self.maximum, value)

    def percentile(self, share: float) -> float | None:
        """Return the value that `share` (0 to 1) of all do not exceed; None without any."""
        if not self._values:
            return None
        ranked = sorted(self._values)
        return ranked[min(math.ceil(share * len(ranked)), len(ranked)) - 1 if share > 0.0 else 0]


class Magnitude:
    """RMS and greatest magnitude of a signal, over all known values."""

    def __init__(self) -> None:
        self.count = 0
        self.maximum: float | None = None
        """The greatest magnitude; None without a value."""
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Take one finite value."""
        self.count += 1
        self.maximum = max(self.maximum or 0.0, abs(value))
        self._squares += value * value

    @property
    def rms(self) -> float | None:
        """Root of the mean square; None without a value."""
        return math.sqrt(self._squares / self.count) if self.count else None


class Measured:
    """RMS and maximum of one quantity: over the whole run, and since the formation has settled."""

    def __init__(self) -> None:
        self.whole, self.after = Magnitude(), Magnitude()
        self.final: float | None = None
        """The newest known value."""

    def add(self, value: float | None) -> None:
        """Take one value; None means unknown."""
        if value is not None:
            self.whole.add(value)
            self.after.add(value)
            self.final = value

    def restart(self) -> None:
        """Start the second half: from now on it may be settled for good."""
        self.after = Magnitude()


class Robot(NamedTuple):
    """One follower over the run."""

    error: Measured
    """Σ over its neighbours of |z_ij - z*_ij| [m]."""
    heading: Measured
    """Estimated less true heading [rad]; empty without ground truth."""
    saturated: tuple[float | None, float | None]
    """Shares of its commands at the limit of the speed and of the turn rate; None without a command."""


class Commands:
    """Commands of one follower."""

    def __init__(self, mission: Mission, name: str) -> None:
        spec = mission.robots[name]
        self._stamped = spec.cmd_vel == "twist_stamped"
        self.curves = Extremes(2)
        self.count = 0
        self._saturated = [0, 0]
        self._limits = SATURATED_SHARE * spec.max_speed, SATURATED_SHARE * spec.max_turn_rate
        self._last = -math.inf

    def process_command(self, payload: bytes, wall: float) -> None:
        """Take one command that arrived at `wall` [s]."""
        try:
            command = decode(TwistStamped, payload) if self._stamped else decode(Twist, payload)
        except BadMessage:
            return
        values = command.speed, command.turn_rate
        self.count += 1
        for i in range(2):
            self._saturated[i] += abs(values[i]) >= self._limits[i]
        if wall - self._last > MAX_LINE_GAP and self.count > 1:
            self.curves.add(self._last, (math.nan, math.nan))
        self._last = wall
        self.curves.add(wall, values)

    @property
    def shares(self) -> tuple[float | None, float | None]:
        """Shares of commands at the limit of the speed and of the turn rate; None without a command."""
        speed, turn_rate = self._saturated
        return (speed / self.count, turn_rate / self.count) if self.count else (None, None)
