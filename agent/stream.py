"""One stream of stamped messages: is it fresh, how old is its newest, can its clock be believed?

Stamps are the sender's system clock, arrivals this process's monotonic one. A stamp counts only as far as
its message can have been on the way. A stream is fresh while messages arrive that are not too late, compared
with the quickest since its clock was set last (`formation.lateness`). So a sender with a wrong clock is still
followed, only without knowing its age, and one whose messages get later and later is not.
"""

from __future__ import annotations

from formation import lateness
from formation.lateness import Delayed, Quickest
from formation.neighbour import FORGOTTEN, FRESH_PERIODS, believed_way, longest_way
from formation.wire import BadMessage, Now

ABSURD = 86_400.0
"""A stamp further than this from our own clock is no time at all [s]."""


class TooLateError(BadMessage):
    """A message that is too old to act on."""


class Stream:
    """Freshness and time of one stream."""

    def __init__(self, rate: float) -> None:
        """`rate` [Hz] is what the topic table and the mission promise."""
        self.limit = FRESH_PERIODS / rate
        """Longest silence of a fresh stream [s]."""
        self.longest_way = longest_way(rate)
        """How long a message can well have been on the way [s]."""
        self.stamp = 0.0
        """Of the newest message [s, sender's clock]."""
        self.arrived: float | None = None
        """Of the newest message [s, monotonic]; None before the first."""
        self.underway = 0.0
        """How long the newest message was on the way, if both clocks are right [s]."""
        self.late = 0.0
        """How much longer than the quickest one the newest message was under way, refused or not [s]."""
        self.received = float("-inf")
        """When that arrived [s, monotonic]."""
        self._suspect: tuple[float, float] | None = None
        self._doubted = False  # until two messages agree anew
        self._quickest: Quickest | None = None
        self._delayed: Delayed | None = None

    def admit(self, stamp: float, arrived: float, now: Now) -> float | None:
        """Let a message in: seconds since the one before, by the sender's clock; None for a fresh start.

        A fresh start is the first message, the first after a long silence, or the first by a clock set anew.
        Raises BadMessage for an absurd stamp, and for one that does not follow from the last: replayed,
        reordered, or by a sender whose clock was set. That one is followed again as soon as the stream as it
        was has fallen silent and two messages agree on the new time; as long as it is fresh, no number of
        replayed ones takes its place. A message said again and again stays refused for ever.

        Raises TooLateError for one that was held up. That is followed again as soon as messages come as
        quickly as before, or have come at one lateness for a minute.
        """
        if abs(now.wall - stamp) > ABSURD:
            raise BadMessage(f"absurd stamp: {stamp - now.wall:+.0f} s from this robot's clock")
        if self.arrived is None:
            return self._begin(stamp, arrived, now)
        elapsed, wait = stamp - self.stamp, arrived - self.arrived
        late = self.check_late(stamp, arrived)
        if elapsed > 0.0 and late > self.longest_way:  # for a minute already
            return self._begin(stamp, arrived, now)
        if self._agree(elapsed, wait) and not self._doubted:
            self.late = max(0.0, late)
            return self._newest(stamp, arrived, now, elapsed if wait <= max(FORGOTTEN, self.limit) else None)
        suspect, self._suspect = self._suspect, (stamp, arrived)
        agree = suspect is not None and self._agree(stamp - suspect[0], arrived - suspect[1])
        if agree and wait > self.limit:
            return self._begin(stamp, arrived, now)
        raise BadMessage(f"stamp out of step: {elapsed:+.3f} s after the one before")

    def doubt(self) -> None:
        """Trust nothing that was heard until two messages agree anew: this process was frozen."""
        self._suspect, self._doubted = None, True

    def check_late(self, stamp: float, arrived: float) -> float:
        """How much longer than the quickest one a message was under way [s]. Raises TooLateError."""
        if self._quickest is None:
            return 0.0
        late = self._quickest.lateness(stamp, arrived)
        if stamp <= self.stamp or late <= self.longest_way:
            return late
        self.late, self.received, self._suspect = late, arrived, None
        self._delayed = lateness.delayed(self._delayed, stamp, arrived)
        if not self._delayed.settled(arrived):
            raise TooLateError(
                f"too late: {late:.2f} s later than the quickest; limit {self.longest_way:g} s"
            )
        return late

    def fresh(self, now: Now) -> bool:
        """Whether the newest message arrived within the limit."""
        return self.arrived is not None and not self._doubted and now.mono - self.arrived <= self.limit

    def silence(self, now: Now) -> float:
        """Time since the newest message arrived [s]; infinite before the first."""
        return float("inf") if self.arrived is None else now.mono - self.arrived

    @property
    def stale_at(self) -> float:
        """When the stream will have been silent for too long [s, monotonic]; long ago before the first."""
        return float("-inf") if self.arrived is None else self.arrived + self.limit

    @property
    def clock_agrees(self) -> bool:
        """Whether the newest message can well have been on the way for as long as its stamp says."""
        return 0.0 <= self.underway <= self.longest_way

    def age(self, now: Now) -> float:
        """Age of the newest message [s]: since it arrived, and its way as far as its stamp is believed."""
        return self.silence(now) + believed_way(self.underway, self.longest_way)

    def _agree(self, by_stamp: float, by_arrival: float) -> bool:
        # the one may have been on the way for as long as can be, the other not at all
        return by_stamp > 0.0 and abs(by_stamp - by_arrival) <= self.longest_way

    def _begin(self, stamp: float, arrived: float, now: Now) -> float | None:
        self.late, self._quickest = 0.0, None
        return self._newest(stamp, arrived, now, None)

    def _newest(self, stamp: float, arrived: float, now: Now, elapsed: float | None) -> float | None:
        self.stamp, self.arrived, self._suspect, self._delayed = stamp, arrived, None, None
        self._doubted = False
        self.received = arrived
        before = self._quickest
        self._quickest = (
            lateness.quickest(stamp, arrived) if before is None else before.followed_by(stamp, arrived)
        )
        self.underway = now.wall - (now.mono - arrived) - stamp
        return elapsed
