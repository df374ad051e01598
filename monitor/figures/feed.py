"""One key as it is heard: how many messages, how fast, how old, what is missing, and whose clock."""

from __future__ import annotations

import math
from collections import deque

FRESH_PERIODS = 3.0
"""A feed that is silent for more than this many of its periods is stale."""
SHORTEST_LIMIT = 0.25
"""But never sooner than this [s]: watching is no hurry, and must not flicker whenever a computer is busy."""
WINDOW = 31
"""Newest messages that rate and clock are judged by."""
CLOCK_AGREES = (-0.02, 1.0)
"""Arrival less stamp of a sender whose clock agrees with ours: network delay, and little else [s]."""
LONGEST_GAP = 1.0
"""After a longer one (or five periods, if those are more) the sender had paused or its clock was set: nothing
was missed on the way [s]."""


def freshness_limit(rate: float) -> float:
    """Longest silence [s] of a fresh feed of `rate` [Hz]."""
    return max(FRESH_PERIODS / rate, SHORTEST_LIMIT)


class Feed:
    """Figures of one key. Times of arrival are this process's: monotonic and system clock [s]."""

    def __init__(self, rate: float | None) -> None:
        """`rate` [Hz] is the promised one; None where nothing is promised."""
        self.limit = freshness_limit(rate) if rate else math.inf
        """Longest silence of a fresh feed [s]."""
        self.count = 0
        """Messages heard, the rejected ones included."""
        self.accepted = -math.inf
        """When the newest arrived that was not rejected [s, monotonic]."""
        self.rejected = -math.inf
        """When the newest arrived that was [s, monotonic]."""
        self.missed = 0
        """Periods without a message in gaps between stamps up to LONGEST_GAP: lost on the way, or skipped."""
        self._nominal = rate
        self._longest_gap = max(LONGEST_GAP, 5.0 / rate) if rate else 0.0
        self._arrivals: deque[float] = deque(maxlen=WINDOW)
        self._offsets: deque[float] = deque(maxlen=WINDOW)
        self._gaps: deque[int] = deque(maxlen=WINDOW)
        self._lately = 0  # the sum of these
        self._stamp = -math.inf
        self._clock = 0.0

    def heard(self, arrived: float) -> None:
        """Count a message, whatever is in it."""
        self.count += 1
        self._arrivals.append(arrived)

    def stamped(self, stamp: float, wall: float) -> float:
        """Note a stamp [s, sender's clock]; that moment by our system clock.

        A clock that agrees with ours is believed as it is. One that does not is set right by the median of
        the offsets, so that a robot with a wrong clock can still be compared with the others.
        """
        gap, self._stamp = stamp - self._stamp, stamp
        if self._nominal and 0.0 < gap <= self._longest_gap:
            missed = max(round(gap * self._nominal) - 1, 0)
            self.missed += missed
            if len(self._gaps) == WINDOW:
                self._lately -= self._gaps[0]
            self._lately += missed
            self._gaps.append(missed)
        self._offsets.append(wall - stamp)
        if len(self._offsets) < WINDOW or self.count % 8 == 0:
            self._clock = sorted(self._offsets)[len(self._offsets) // 2]
        return stamp if self.clock_agrees else stamp + self._clock

    def forget_clock(self) -> None:
        """Learn the sender's clock against ours anew, as after ours was set."""
        self._offsets.clear()

    @property
    def clock(self) -> float | None:
        """Median of arrival less stamp [s]: the sender's clock against ours, plus the network's delay.

        None before the first stamp.
        """
        return self._clock if self._offsets else None

    @property
    def clock_agrees(self) -> bool:
        """Whether the sender's clock can be believed."""
        return CLOCK_AGREES[0] <= self._clock <= CLOCK_AGREES[1]

    @property
    def loss(self) -> float | None:
        """Share of the newest periods that were missed; None before the second stamp."""
        return self._lately / (self._lately + len(self._gaps)) if self._gaps else None

    def silence(self, mono: float) -> float:
        """Time since the last message that was not rejected [s]; infinite before the first."""
        return mono - self.accepted

    def fresh(self, mono: float) -> bool:
        """Whether a message that was not rejected has come within the limit."""
        return self.silence(mono) <= self.limit

    def rate(self, mono: float) -> float | None:
        """Messages per second, over the newest few; falls while nothing comes. None before the second."""
        if len(self._arrivals) < 2:
            return None
        span = self._arrivals[-1] - self._arrivals[0]
        intervals = len(self._arrivals) - 1
        silence = mono - self._arrivals[-1]
        if silence * intervals > 2.0 * span:  # quiet for longer than it has been between two messages
            span, intervals = span + silence, intervals + 1
        return intervals / span if span > 0.0 else None
