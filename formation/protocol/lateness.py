"""Which messages of a stream are too late to act on, by how much, and when their clock was set.

Only differences count here, so it works whatever the sender's clock says. The *offset* of a message is its
arrival (receiver's clock) less its stamp (sender's clock): the offset of the two clocks plus the delay of
the message. The quickest message has the least offset; the excess of another one is its *lateness*. A
queue that grows anywhere on the way, or a sensor that falls behind, shows as growing lateness.

A clock that is set changes all offsets at once, while messages continue to arrive. The stamps distinguish
that from a queue: those of delayed messages continue from the last, those of a clock that was set back do
not.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

MAX_CLOCK_DRIFT = 5e-4
"""Greatest drift between two clocks, also while one of them is slewed [s/s]."""
SETTLED_TIME = 60.0
"""Time at one lateness after which it is the normal delay [s]."""
MAX_LATENESS_SPREAD = 0.1
"""Greatest variation of one lateness [s]."""
MAX_BEAT_LATENESS = 1.0
"""Lateness of a beat, from the quickest of its term, beyond which its order is too old to act on [s]."""
CLEAR_SHARE = 0.8
"""Share of the limit below which a robot that holds for its position's age may continue."""
RECOVERY_TIME = 0.5
"""Time below that share after which it continues [s]."""
MAX_RECOVERY_TIME = 10.0
"""Time below the limit itself after which it continues [s]: the normal age may be near the limit."""

LATE_GAIN = 4.0
"""Gain down to which a law without integral is lowered for late positions; then the robot holds [1/s]."""


class Quickest(NamedTuple):
    """The quickest message of a stream since its sender's clock was set last."""

    offset: float
    """Arrival less stamp [s]."""
    arrived: float
    """[s, receiver's clock]"""

    def lateness(self, stamp: float, arrived: float) -> float:
        """Delay of another message in excess of this one's [s]; negative if it was quicker."""
        return arrived - stamp - self.offset - MAX_CLOCK_DRIFT * max(0.0, arrived - self.arrived)

    def followed_by(self, stamp: float, arrived: float) -> Quickest:
        """The quickest message after one more."""
        if self.lateness(stamp, arrived) > 0.0:
            return self
        return Quickest(arrived - stamp, arrived)


def quickest(stamp: float, arrived: float) -> Quickest:
    """Return the first message of a stream as its quickest so far."""
    return Quickest(arrived - stamp, arrived)


class Delayed(NamedTuple):
    """A series of messages that came too late: its start, and bounds of its offsets."""

    since: float
    """When the first of them arrived [s, receiver's clock]."""
    least: float
    most: float
    """Of their offsets [s]."""

    def settled(self, arrived: float) -> bool:
        """Whether it has lasted so long that it is the normal delay by now."""
        return arrived - self.since >= SETTLED_TIME


def delayed(before: Delayed | None, stamp: float, arrived: float) -> Delayed:
    """The series with one more late message; another lateness begins a new series."""
    offset = arrived - stamp
    if before is None:
        return Delayed(arrived, offset, offset)
    least, most = min(before.least, offset), max(before.most, offset)
    return (
        Delayed(arrived, offset, offset)
        if most - least > MAX_LATENESS_SPREAD
        else Delayed(before.since, least, most)
    )


class Count(NamedTuple):
    """Lateness of a count at an even rate instead of stamps: a leader's beats within one term."""

    term: int
    quickest: Quickest
    delayed: Delayed | None


def counted(
    before: Count | None, term: int, stamp: float, arrived: float, limit: float
) -> tuple[Count, float]:
    """Update with one more message; return its lateness too [s]; over `limit` [s] it is too old to act on.

    `stamp` [s] is its count times the period. Another term starts afresh.
    """
    if before is None or term != before.term:
        return Count(term, quickest(stamp, arrived), None), 0.0
    late = before.quickest.lateness(stamp, arrived)
    if late <= limit:
        return Count(before.term, before.quickest.followed_by(stamp, arrived), None), late
    series = delayed(before.delayed, stamp, arrived)
    if series.settled(arrived):
        return Count(before.term, quickest(stamp, arrived), None), 0.0
    return Count(before.term, before.quickest, series), late


@lru_cache(maxsize=64)
def own_age_limit(neighbours: int, k_p: float, k_i: float, rate: float, longest: float) -> float:
    """Greatest age of a robot's own position in the law [s]: half of its loop's delay margin.

    The delay margin is that of λ² + (k_P λ + k_I) d e^{-λτ} with d neighbours, as in
    `formation.stability.spectrum.delay_margin`. Sampling, and turning by an old heading, take up to half
    of it (docs/decisions/0045-late-messages.md). At least two periods of `rate` [Hz], at most
    `longest` [s].
    """
    if k_p <= 0.0 or neighbours < 1:
        return longest
    gain = neighbours * k_p
    omega = math.sqrt(0.5 * (gain**2 + math.sqrt(gain**4 + 4.0 * (neighbours * k_i) ** 2)))
    margin = math.atan2(k_p * omega, k_i) / omega
    return min(longest, max(0.5 * margin, 2.0 / rate))


def bearable_gain(gain: float, age: float) -> float:
    """`gain` [1/s] of a loop without integral, or less: half of its delay margin is at least `age` [s]."""
    return min(gain, 0.25 * math.pi / age) if age > 0.0 else gain


class Trust(NamedTuple):
    """Whether a robot's own position is young enough to act on, with hysteresis."""

    held: bool = False
    """Whether it is too old."""
    since: float = -math.inf
    """Since when it has been well under the limit again [s, monotonic]."""
    below: float = -math.inf
    """Since when it has been under the limit again [s, monotonic]."""


def trusted(before: Trust, age: float, limit: float, moment: float) -> Trust:
    """Whether a position that is `age` [s] old when it comes may be acted on at `moment` [s, monotonic].

    Over `limit` [s] it may not; then not again before it has stayed under `CLEAR_SHARE` of it for
    `RECOVERY_TIME`, or under it for `MAX_RECOVERY_TIME`.
    """
    if age > limit:
        return Trust(held=True, since=math.inf, below=math.inf)
    if not before.held:
        return before
    since = min(before.since, moment) if age <= CLEAR_SHARE * limit else math.inf
    below = min(before.below, moment)
    held = moment - since < RECOVERY_TIME and moment - below < MAX_RECOVERY_TIME
    return Trust(held=held, since=since, below=below)
