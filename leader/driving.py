"""Driving by hand: velocities that a driver sends again and again, each of which expires soon.

Each reply of the leader has a *token*, its own monotonic clock [ms] from a number on that it draws at its
start. A velocity must return the token of a reply: the leader accepts it within `DRIVE_TIMEOUT_SECONDS` of
that reply, and moves by it no longer than that. So however late, repeated or recorded a message is, and
whatever a clock says, the leader stands at most `DRIVE_TIMEOUT_SECONDS` after the driver's newest input. A
token of another process is never valid by chance of two clocks. The first request of a driver has no token
and moves nothing.

A driver must let go, that is send zero, before it moves the leader if it was refused as another drives or the
fleet is held, if a speed or a route was ordered while it drove, or if it drove before this leader led.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from zlib import crc32

from formation.control.plane import clip
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.protocol.stops import Result
from formation.stability.driving import STANDS, Limits, Velocity, followable

RAMP_SECONDS = 0.5
"""Shortest time from rest to the limit of the driven speed or turn rate [s]."""
TOKEN_SECONDS = 1e-3
"""Unit of a token [s]."""
IDLE_SECONDS = 1.0
"""Time since its newest velocity that was not zero after which a driver keeps no other out [s]."""
MAX_DRIVERS = 16
"""Number of drivers that are remembered; an older one must let go first."""
ORDERED, LET_GO = "a route or a speed was ordered: ", "let go, then drive again"


def ramped(before: Velocity, wanted: Velocity, within: Limits, dt: float) -> Velocity:
    """Return the velocity `dt` [s] after `before` on the way to `wanted`."""
    share = min(dt / RAMP_SECONDS, 1.0)

    def nearer(start: float, end: float, limit: float) -> float:
        return start + clip(end - start, share * limit)

    return Velocity(
        nearer(before.forward, wanted.forward, within.speed),
        nearer(before.turn_rate, wanted.turn_rate, within.turn_rate),
    )


@dataclass(slots=True)
class _Known:
    """One driver, as far as this leader knows."""

    begins: bool
    """Whether its first request here had no token, and nothing has been against it since."""
    counts: bool = False
    """Whether it has let go, or driven, since it was last refused."""
    released: bool = False
    """Whether its newest velocity is zero."""
    newest: int = 0
    """Newest token that it has returned."""

    def outdated(self, wanted: Velocity, returned: int, age: float) -> str:
        """Return why a velocity is too old that returns a token of `age` [s]; empty if it is not."""
        if not 0.0 <= age <= DRIVE_TIMEOUT_SECONDS:
            self.begins = False  # its token is not that of its first reply
            return f"too late: it answers a reply from {age:.2f} s ago; limit {DRIVE_TIMEOUT_SECONDS:g} s"
        # of two that return one token the release counts, as it may be the newer one
        repeated = returned == self.newest and self.released and wanted != STANDS
        return "overtaken by a newer one" if returned < self.newest or repeated else ""


class Driver:
    """The driver of one leader: its newest accepted velocity, and until when that counts."""

    def __init__(self, publisher_id: str = "", moved: float = -math.inf) -> None:
        """`publisher_id`: of the leader's process, from which the first token follows.

        `moved`: when an earlier leader may have been driven last [s, monotonic].
        """
        self.name = ""
        """Id of the driver; empty before the first."""
        self.wanted = STANDS
        self.velocity = STANDS
        """The ramped one."""
        self.until = -math.inf
        """When it expires [s, monotonic]."""
        self._first = crc32(publisher_id.encode())
        self._ended = False  # whether a route was ordered, and no driver has taken the leader from it
        self._moved = moved  # when a velocity counted last that was not zero [s, monotonic]
        self._known: dict[str, _Known] = {}  # by id, the one that was heard last at the end

    def token(self, moment: float) -> int:
        """Return the token of a reply at `moment` [s, monotonic]."""
        return self._first + math.floor(moment / TOKEN_SECONDS)

    def live(self, moment: float) -> bool:
        """Whether its velocity counts at `moment` [s, monotonic], and is not zero."""
        return moment < self.until and self.wanted != STANDS

    def drives(self, moment: float) -> bool:
        """Whether a velocity that is not zero has counted lately at `moment` [s, monotonic]."""
        return moment - self._moved < IDLE_SECONDS

    def stand(self) -> None:
        """Start the next motion from rest."""
        self.velocity = STANDS

    def end(self) -> None:
        """Leave the leader to an ordered route, until a driver begins, or lets go and drives again."""
        self._ended, self.until = True, -math.inf
        for one in self._known.values():
            one.begins, one.counts = False, one.released

    def accept(
        self, name: str, wanted: Velocity, returned: int, moment: float, refusal: Result | None = None
    ) -> Result:
        """Take a velocity that arrived at `moment` [s, monotonic] with the token `returned`.

        Return whether it counts, or why not: `refusal` if the fleet is held. A copy of a request has its
        token, so it counts no longer than the request itself.
        """
        if not name:  # two without one would count as one driver
            return Result(ok=False, reason="a driver must have an id")
        one = self._recalled(name, begins=returned == 0)
        if returned == 0:
            return refusal or Result(ok=False, reason="the first request fetches a token", code="first")
        issued = (returned - self._first) * TOKEN_SECONDS
        if why := one.outdated(wanted, returned, moment - issued):
            return refusal or Result(ok=False, reason=why)
        one.newest, one.released = returned, wanted == STANDS
        one.counts = one.counts or one.released
        if refusal is None and (why := self._refusal(name, one, moment)):
            refusal = Result(ok=False, reason=why)
        if refusal is not None:
            if not one.released:
                one.begins = one.counts = False
            return refusal
        one.counts, self._ended = True, False
        self.name, self.wanted, self.until = name, wanted, issued + DRIVE_TIMEOUT_SECONDS
        if not one.released:
            self._moved = moment
        return Result(ok=True)

    def _recalled(self, name: str, *, begins: bool) -> _Known:
        """Return what is known of a driver; `begins`: whether it begins, if it is unknown."""
        one = self._known[name] = self._known.pop(name, _Known(begins))
        if len(self._known) > MAX_DRIVERS:
            del self._known[next(iter(self._known))]
        return one

    def _refusal(self, name: str, one: _Known, moment: float) -> str:
        """Return why the newest velocity of a driver does not count; empty if it does."""
        other = name != self.name and moment < self.until
        if other and self.drives(moment):
            return f"{self.name} drives"
        if one.begins and not other:
            return ""
        if not one.counts:
            return f"{ORDERED if self._ended else ''}{LET_GO}"
        # zero is no wish to drive: it leaves a route that was ordered
        return f"{ORDERED}{LET_GO}" if self._ended and one.released else ""

    def advance(self, within: Limits, dt: float, moment: float) -> Velocity:
        """Return the velocity for the next step, `dt` [s] after the one before; zero once it has expired."""
        if self.live(moment):
            self.velocity = ramped(self.velocity, followable(self.wanted, within), within, dt)
        else:
            self.stand()
        return self.velocity
