"""Too old to act on: which messages of a stream come too late, by how much, and when their clock was set.

Only differences count here, so it works whatever the sender's clock says. The *offset* of a message is its
arrival (receiver's clock) less its stamp (sender's clock): the offset of the two clocks plus the time that
the message was under way. The quickest message has the least offset; how much larger another one is, is its
*lateness*. A queue that grows anywhere on the way, or a sensor that falls behind, shows as growing lateness.

A clock that is set changes all offsets at once, while messages go on arriving. That is told from a queue by
the stamps:
those of messages that were held up go on from the last, those of a clock that was set
back do not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

DRIFT = 5e-4
"""Two clocks run apart by at most this much, while one of them is slewed as well [s/s]."""
SETTLED = 60.0
"""After so long at one lateness, that is how long messages are under way now [s]."""
SPREAD = 0.1
"""Lateness that varies by no more than this is one lateness [s]."""
MAX_BEAT_LATENESS = 1.0
"""An order whose beat comes this much later than the quickest of its term is too old to act on [s]."""
CLEAR = 0.8
"""A robot that holds because its position is too old goes on below this share of the limit …"""
RECOVERED = 0.5
"""… once it has been there for so long [s]."""


class Quickest(NamedTuple):
    """The quickest message of a stream since its sender's clock was set last."""

    offset: float
    """Arrival less stamp [s]."""
    arrived: float
    """[s, receiver's clock]"""

    def lateness(self, stamp: float, arrived: float) -> float:
        """How much longer than this one another message was under way [s]; negative if it was quicker."""
        return arrived - stamp - self.offset - DRIFT * max(0.0, arrived - self.arrived)

    def followed_by(self, stamp: float, arrived: float) -> Quickest:
        """The quickest message when one more has come."""
        if self.lateness(stamp, arrived) > 0.0:
            return self
        return Quickest(arrived - stamp, arrived)


def quickest(stamp: float, arrived: float) -> Quickest:
    """The first message of a stream is its quickest so far."""
    return Quickest(arrived - stamp, arrived)


class Delayed(NamedTuple):
    """A series of messages that came too late: for how long, and between which bounds."""

    since: float
    """When the first of them arrived [s, receiver's clock]."""
    least: float
    most: float
    """Of their offsets [s]."""

    def settled(self, arrived: float) -> bool:
        """Whether this has gone on for so long that it is how long messages are under way by now."""
        return arrived - self.since >= SETTLED


def delayed(before: Delayed | None, stamp: float, arrived: float) -> Delayed:
    """The series with one more message that came too late; another lateness begins a new series."""
    offset = arrived - stamp
    if before is None:
        return Delayed(arrived, offset, offset)
    least, most = min(before.least, offset), max(before.most, offset)
    return Delayed(arrived, offset, offset) if most - least > SPREAD else Delayed(before.since, least, most)


class Count(NamedTuple):
    """Lateness of what is counted at an even rate instead of stamped: a leader's beats within one term."""

    term: int
    quickest: Quickest
    delayed: Delayed | None


def counted(
    before: Count | None, term: int, stamp: float, arrived: float, limit: float
) -> tuple[Count, float]:
    """What is known after one more message, and its lateness [s]; over `limit` [s] it is too old to act on.

    `stamp` [s] is its count by the period. Another term begins anew.
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


def own_age_limit(neighbours: int, k_p: float, k_i: float, rate: float, longest: float) -> float:
    """How old a robot's own position may be when the law uses it [s]: half of its loop's delay margin.

    The delay margin is that of λ² + (k_P λ + k_I) d e^{-λτ} with d neighbours, as in
    `formation.stability.spectrum.delay_margin`. Sampling, and turning by an old heading, take up to half of
    it (docs/decisions/0045-too-old-to-act-on.md). At least two periods of `rate` [Hz], at most `longest` [s].
    """
    if k_p <= 0.0 or neighbours < 1:
        return longest
    gain = neighbours * k_p
    omega = math.sqrt(0.5 * (gain**2 + math.sqrt(gain**4 + 4.0 * (neighbours * k_i) ** 2)))
    margin = math.atan2(k_p * omega, k_i) / omega
    return min(longest, max(0.5 * margin, 2.0 / rate))


class Trust(NamedTuple):
    """Whether a robot's own position is young enough to act on, with hysteresis."""

    held: bool = False
    """Whether it is not."""
    since: float = -math.inf
    """Since when it has been well under the limit again [s, monotonic]."""


def trusted(before: Trust, age: float, limit: float, moment: float) -> Trust:
    """Whether a position that is `age` [s] old when it comes may be acted on at `moment` [s, monotonic].

    Over `limit` [s] it may not; then not again before it has stayed under `CLEAR` of it for `RECOVERED`.
    """
    if age > limit:
        return Trust(held=True, since=math.inf)
    if not before.held:
        return before
    if age > CLEAR * limit:
        return Trust(held=True, since=math.inf)
    since = min(before.since, moment)
    return Trust(held=moment - since < RECOVERED, since=since)
