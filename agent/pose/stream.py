"""One stream of stamped messages: freshness, age of the newest, and whether its clock can be believed.

Stamps are the sender's system clock, arrivals this process's monotonic one. A stamp is believed only within
the possible delay of its message. A stream is fresh while messages arrive that are not too late, compared
with the quickest since its clock was set last (`formation.protocol.lateness`). So a sender with a wrong clock
is still followed, with unknown age, and one with messages that get later and later is not.
"""

from __future__ import annotations

from dataclasses import dataclass

from formation.control.tracker import FORGETTING_SILENCE, FRESH_PERIODS, believed_delay, longest_delay
from formation.protocol import lateness
from formation.protocol.lateness import Delayed, Quickest
from formation.wire import BadMessage, Now

MAX_STAMP_OFFSET = 86_400.0
"""Difference of a stamp from this process's clock from which it is invalid [s]."""


class TooLateError(BadMessage):
    """A message that is too old to act on."""


@dataclass(slots=True, kw_only=True)
class StreamState:
    """What a stream has learned."""

    stamp: float = 0.0
    """Of the newest message [s, sender's clock]."""
    arrived: float | None = None
    """Of the newest message [s, monotonic]; None before the first."""
    delay: float = 0.0
    """Delay of the newest message, if both clocks are right [s]."""
    late: float = 0.0
    """Delay of the newest message, refused or not, in excess of the quickest one's [s]."""
    received: float = float("-inf")
    """When that message arrived [s, monotonic]."""
    suspect: tuple[float, float] | None = None
    """Stamp [s, sender's clock] and arrival [s, monotonic] of a message that did not follow."""
    doubted: bool = False
    """Whether nothing counts until two new messages agree."""
    ahead: float | None = None
    """This process's system clock less its monotonic one at the newest message [s]; None before the first."""
    step: tuple[float, float] = (0.0, float("-inf"))
    """By how much this process's clock was set last [s], and when that was noticed [s, monotonic]."""
    quickest: Quickest | None = None
    delayed: Delayed | None = None


class Stream:
    """Freshness and time of one stream."""

    def __init__(self, rate: float) -> None:
        """`rate` [Hz] is the rate in the topic table and the mission."""
        self.limit = FRESH_PERIODS / rate
        """Longest silence of a fresh stream [s]."""
        self.longest_delay = longest_delay(rate)
        """Longest plausible delay of a message [s]."""
        self.state = StreamState()

    def admit(self, stamp: float, arrived: float, now: Now) -> float | None:
        """Accept a message; the time since the one before [s, sender's clock]; None if it starts afresh.

        The first message starts afresh, also after a long silence or with a clock set anew. Raises
        BadMessage for an invalid stamp, and for one that does not follow from the last: replayed,
        reordered, or after the sender's clock was set. The latter is accepted as soon as the old stream
        has fallen silent and two messages agree on the new time; while it is fresh, no number of replayed
        messages replaces it. A message that is repeated stays refused for ever.

        Raises TooLateError for a delayed one. Such messages are accepted again as soon as they come as
        quickly as before, or have come at one lateness for a minute.
        """
        state = self.state
        if abs(now.wall - stamp) > MAX_STAMP_OFFSET:
            raise BadMessage(f"absurd stamp: {stamp - now.wall:+.0f} s from this robot's clock")
        if state.arrived is None:
            return self._begin(stamp, arrived, now)
        elapsed, wait = stamp - state.stamp, arrived - state.arrived
        self._notice_step(now)
        if self._steps(arrived) and self._agree(elapsed - state.step[0], wait):
            return self._begin(stamp, arrived, now)  # the sender's clock was set too: it is the same one
        late = self.check_late(stamp, arrived)
        if elapsed > 0.0 and late > self.longest_delay:  # already for a minute
            return self._begin(stamp, arrived, now)
        if self._agree(elapsed, wait) and not state.doubted:
            state.late = max(0.0, late)
            return self._newest(
                stamp, arrived, now, elapsed if wait <= max(FORGETTING_SILENCE, self.limit) else None
            )
        suspect, state.suspect = state.suspect, (stamp, arrived)
        agree = suspect is not None and self._agree(stamp - suspect[0], arrived - suspect[1])
        if agree and wait > self.limit:
            return self._begin(stamp, arrived, now)
        raise BadMessage(f"stamp out of step: {elapsed:+.3f} s after the one before")

    def doubt(self) -> None:
        """Distrust everything received until two new messages agree: this process was frozen."""
        self.state.suspect, self.state.doubted = None, True

    def check_late(self, stamp: float, arrived: float) -> float:
        """A message's delay in excess of the quickest one's [s]. Raises TooLateError."""
        state = self.state
        if state.quickest is None:
            return 0.0
        late = state.quickest.lateness(stamp, arrived)
        if stamp <= state.stamp or late <= self.longest_delay:
            return late
        state.late, state.received, state.suspect = late, arrived, None
        state.delayed = lateness.delayed(state.delayed, stamp, arrived)
        if not state.delayed.settled(arrived):
            raise TooLateError(
                f"too late: {late:.2f} s later than the quickest; limit {self.longest_delay:g} s"
            )
        return late

    def fresh(self, now: Now) -> bool:
        """Whether the newest message arrived within the limit."""
        state = self.state
        return state.arrived is not None and not state.doubted and now.mono - state.arrived <= self.limit

    def silence(self, now: Now) -> float:
        """Time since the newest message arrived [s]; infinite before the first."""
        return float("inf") if self.state.arrived is None else now.mono - self.state.arrived

    @property
    def stale_at(self) -> float:
        """When the stream will have been silent for too long [s, monotonic]; -inf before the first."""
        return float("-inf") if self.state.arrived is None else self.state.arrived + self.limit

    @property
    def clock_agrees(self) -> bool:
        """Whether the newest message's delay by its stamp is plausible."""
        return 0.0 <= self.state.delay <= self.longest_delay

    def age(self, now: Now) -> float:
        """Age of the newest message [s]: time since its arrival, and its delay as far as believed."""
        return self.silence(now) + self.believed_delay

    @property
    def believed_delay(self) -> float:
        """Delay of the newest message by its stamp, as far as believed [s]."""
        return believed_delay(self.state.delay, self.longest_delay)

    @property
    def age_on_arrival(self) -> float:
        """Age of the newest message on arrival [s], refused or not, by stamp or beside the quickest.

        A stamp from the future gives no age. A stamp from the past may be of a wrong clock, but a late driver
        sends the same stamp, so it counts.
        """
        refused = self.state.arrived is None or self.state.received > self.state.arrived
        return self.state.late if refused else max(self.state.late, self.state.delay)

    def _agree(self, by_stamp: float, by_arrival: float) -> bool:
        # one may have had the longest delay, the other none
        return by_stamp > 0.0 and abs(by_stamp - by_arrival) <= self.longest_delay

    def _begin(self, stamp: float, arrived: float, now: Now) -> float | None:
        self.state.late, self.state.quickest = 0.0, None
        return self._newest(stamp, arrived, now, None)

    def _newest(self, stamp: float, arrived: float, now: Now, elapsed: float | None) -> float | None:
        state = self.state
        state.stamp, state.arrived, state.received = stamp, arrived, arrived
        state.suspect, state.delayed, state.doubted = None, None, False
        before = state.quickest
        state.quickest = (
            lateness.quickest(stamp, arrived) if before is None else before.followed_by(stamp, arrived)
        )
        state.ahead = now.wall - now.mono
        state.delay = arrived + state.ahead - stamp
        if self._steps(
            arrived
        ):  # stamped before: by the smaller delay, so a clock that is set holds no robot
            state.delay = min(state.delay, state.delay - state.step[0], key=abs)
        return elapsed

    def _notice_step(self, now: Now) -> None:
        """Note when this process's clock was set since the newest message."""
        ahead = now.wall - now.mono
        step = 0.0 if self.state.ahead is None else ahead - self.state.ahead
        if abs(step) > self.longest_delay:
            self.state.step = step, now.mono

    def _steps(self, arrived: float) -> bool:
        """Whether messages may be under way since this process's clock was set."""
        return arrived - self.state.step[1] <= self.longest_delay
