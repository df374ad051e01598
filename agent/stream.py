"""One stream of stamped messages: is it fresh, how old is its newest, can its clock be believed?

Stamps are the sender's system clock, arrivals this process's monotonic one. A stamp counts only while it
agrees with the arrival; whether a stream is fresh is a matter of arrival alone, so a sender with a wrong
clock is still followed, only without knowing its age.
"""

from __future__ import annotations

from formation.wire import BadMessage, Now

FRESH_PERIODS = 3.0
"""A stream that has been silent for more than this many of its periods is stale."""
ABSURD = 86_400.0
"""A stamp further than this from our own clock is no time at all [s]."""


class Stream:
    """Freshness and time of one stream."""

    def __init__(self, rate: float) -> None:
        """`rate` [Hz] is what the topic table and the mission promise."""
        self.limit = FRESH_PERIODS / rate
        """Longest silence of a fresh stream, and oldest believable age [s]."""
        self.stamp = 0.0
        """Of the newest message [s, sender's clock]."""
        self.arrived: float | None = None
        """Of the newest message [s, monotonic]; None before the first."""
        self._suspect: tuple[float, float] | None = None

    def admit(self, stamp: float, arrived: float, now: Now) -> float | None:
        """Let a message in: seconds since the one before, by the sender's clock; None for a fresh start.

        A fresh start is the first message, the first after silence, or the first by a clock set anew.
        Raises BadMessage for an absurd stamp, and for one that does not follow from the last: replayed,
        reordered, or the first after the sender's clock was set (the second then confirms the new time).
        """
        if abs(now.wall - stamp) > ABSURD:
            raise BadMessage(f"absurd stamp: {stamp - now.wall:+.0f} s from this robot's clock")
        if self.arrived is None or arrived - self.arrived > self.limit:
            return self._newest(stamp, arrived, None)
        elapsed = stamp - self.stamp
        if self._agree(elapsed, arrived - self.arrived):
            return self._newest(stamp, arrived, elapsed)
        suspect, self._suspect = self._suspect, (stamp, arrived)
        if suspect is not None and self._agree(stamp - suspect[0], arrived - suspect[1]):
            return self._newest(stamp, arrived, None)
        raise BadMessage(f"stamp out of step: {elapsed:+.3f} s after the one before")

    def fresh(self, now: Now) -> bool:
        """Whether the newest message arrived within the limit."""
        return self.arrived is not None and now.mono - self.arrived <= self.limit

    def silence(self, now: Now) -> float:
        """Time since the newest message arrived [s]; infinite before the first."""
        return float("inf") if self.arrived is None else now.mono - self.arrived

    @property
    def stale_at(self) -> float:
        """When the stream will have been silent for too long [s, monotonic]; long ago before the first."""
        return float("-inf") if self.arrived is None else self.arrived + self.limit

    def clock_agrees(self, now: Now) -> bool:
        """Whether the stamp gives a believable age, so that it may be used."""
        return 0.0 <= now.wall - self.stamp <= self.limit

    def age(self, now: Now) -> float:
        """Age of the newest message [s]: by its stamp while that is believable, else since it arrived."""
        return now.wall - self.stamp if self.clock_agrees(now) else self.silence(now)

    def _agree(self, by_stamp: float, by_arrival: float) -> bool:
        return by_stamp > 0.0 and abs(by_stamp - by_arrival) <= self.limit

    def _newest(self, stamp: float, arrived: float, elapsed: float | None) -> float | None:
        self.stamp, self.arrived, self._suspect = stamp, arrived, None
        return elapsed
