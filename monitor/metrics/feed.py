"""Reception of one key: number, rate, age and losses of messages, and the sender's clock."""

from __future__ import annotations

import math
from collections import deque

FRESH_PERIODS = 3.0
"""Periods of silence after which a feed is stale."""
MIN_SILENCE_LIMIT = 0.25
"""Shortest silence of a stale feed [s], so that a busy computer causes no flicker."""
WINDOW_MESSAGES = 31
"""Number of newest messages for rate and clock."""
CLOCK_AGREES = (-0.02, 1.0)
"""Range of arrival less stamp for a clock that agrees with ours: network delay and little else [s]."""
MAX_GAP = 1.0
"""Longest gap with lost messages (or five periods, if longer) [s]; in a longer one the sender paused or its
clock was set."""


def freshness_limit(rate: float) -> float:
    """Return the longest silence [s] of a fresh feed of `rate` [Hz]."""
    return max(FRESH_PERIODS / rate, MIN_SILENCE_LIMIT)


def clock_agrees(offset: float) -> bool:
    """Return whether a clock with this median of arrival less stamp [s] agrees with ours."""
    return CLOCK_AGREES[0] <= offset <= CLOCK_AGREES[1]


def finite(value: float) -> float | None:
    """Return the value; None for NaN and infinity, which mean unknown."""
    return value if math.isfinite(value) else None


def rounded(value: float | None, digits: int = 3) -> float | None:
    """Return the value for JSON, with so many decimals; None if it is unknown or not finite."""
    return None if value is None or not math.isfinite(value) else round(value, digits)


class Feed:
    """Metrics of one key. Times of arrival are on this process's clocks: monotonic and system [s]."""

    def __init__(self, rate: float | None) -> None:
        """`rate` [Hz]: the promised one, or None."""
        self.limit = freshness_limit(rate) if rate else math.inf
        """Longest silence of a fresh feed [s]."""
        self.count = 0
        """Number of messages received, rejected ones included."""
        self.accepted = -math.inf
        """Arrival of the newest accepted message [s, monotonic]."""
        self.rejected = -math.inf
        """Arrival of the newest rejected message [s, monotonic]."""
        self.missed = 0
        """Periods without a message in gaps between stamps up to MAX_GAP: lost on the way, or skipped."""
        self._nominal = rate
        self._longest_gap = max(MAX_GAP, 5.0 / rate) if rate else 0.0
        self._arrivals: deque[float] = deque(maxlen=WINDOW_MESSAGES)
        self._offsets: deque[float] = deque(maxlen=WINDOW_MESSAGES)
        self._gaps: deque[int] = deque(maxlen=WINDOW_MESSAGES)
        self._stamp = -math.inf
        self._clock = 0.0

    def received(self, arrived: float) -> None:
        """Count a message of any content."""
        self.count += 1
        self._arrivals.append(arrived)

    def stamped(self, stamp: float, wall: float) -> float:
        """Note a stamp [s, sender's clock]; return that moment by our system clock.

        A clock that agrees with ours is used as it is. Another is corrected by the median of the offsets, so
        that a robot with a wrong clock can still be compared with the others.
        """
        gap = stamp - self._stamp
        if not -self._longest_gap < gap <= 0.0:  # an earlier one is of a second sender, or repeated
            self._stamp = stamp
        if self._nominal and 0.0 < gap <= self._longest_gap:
            missed = max(round(gap * self._nominal) - 1, 0)
            self.missed += missed
            self._gaps.append(missed)
        self._offsets.append(wall - stamp)
        if len(self._offsets) < WINDOW_MESSAGES or self.count % 8 == 0:
            self._clock = sorted(self._offsets)[len(self._offsets) // 2]
        return stamp if clock_agrees(self._clock) else stamp + self._clock

    def forget_clock(self) -> None:
        """Forget the sender's clock offset, as after our clock was set."""
        self._offsets.clear()

    @property
    def clock(self) -> float | None:
        """Median of arrival less stamp [s]: the sender's clock against ours, plus the network's delay.

        None before the first stamp.
        """
        return self._clock if self._offsets else None

    @property
    def loss(self) -> float | None:
        """Share of the newest periods that were missed; None before the second stamp."""
        missed = sum(self._gaps)
        return missed / (missed + len(self._gaps)) if self._gaps else None

    def silence(self, mono: float) -> float:
        """Return the time since the last accepted message [s]; infinite before the first."""
        return mono - self.accepted

    def fresh(self, mono: float) -> bool:
        """Return whether an accepted message has come within the limit."""
        return self.silence(mono) <= self.limit

    def rate(self, mono: float) -> float | None:
        """Return the rate of the newest messages [Hz]; it falls during silence. None before the second."""
        if len(self._arrivals) < 2:
            return None
        span = self._arrivals[-1] - self._arrivals[0]
        intervals = len(self._arrivals) - 1
        silence = mono - self._arrivals[-1]
        if silence * intervals > 2.0 * span:  # silent for longer than any gap between two messages
            span, intervals = span + silence, intervals + 1
        return intervals / span if span > 0.0 else None
