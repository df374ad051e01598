"""Driving by hand: velocities that a driver sends again and again, each of which expires soon.

Each reply of the leader has a *token*, its own monotonic clock [ms] from a number on that it draws at its
start. A velocity must return the token of a reply: the leader accepts it within `DRIVE_TIMEOUT_SECONDS` of
that reply, and moves by it no longer than that. So however late, repeated or recorded a message is, and
whatever a clock says, the leader stands at most `DRIVE_TIMEOUT_SECONDS` after the driver's newest input. A
token of another process is never valid by chance of two clocks. The first request of a driver has no token
and moves nothing.
"""

from __future__ import annotations

import math
from zlib import crc32

from formation.control.plane import clip
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.protocol.stops import Result
from formation.stability.driving import STANDS, Limits, Velocity, followable

RAMP_SECONDS = 0.5
"""Shortest time from rest to the limit of the driven speed or turn rate [s]."""
TOKEN_SECONDS = 1e-3
"""Unit of a token [s]."""


def ramped(before: Velocity, wanted: Velocity, within: Limits, dt: float) -> Velocity:
    """Return the velocity `dt` [s] after `before` on the way to `wanted`."""
    share = min(dt / RAMP_SECONDS, 1.0)

    def nearer(start: float, end: float, limit: float) -> float:
        return start + clip(end - start, share * limit)

    return Velocity(
        nearer(before.forward, wanted.forward, within.speed),
        nearer(before.turn_rate, wanted.turn_rate, within.turn_rate),
    )


class Driver:
    """The driver of one leader: its newest accepted velocity, and until when that counts."""

    def __init__(self, publisher_id: str = "") -> None:
        """`publisher_id`: of the leader's process, from which the first token follows."""
        self.name = ""
        """Id of the driver; empty before the first."""
        self.wanted = STANDS
        self.velocity = STANDS
        """The ramped one."""
        self.until = -math.inf
        """When it expires [s, monotonic]."""
        self.newest = 0
        """Newest token that was returned."""
        self._first = crc32(publisher_id.encode())
        self._ended = False  # whether a route was ordered, and no driver has taken the leader from it
        self._began = self._let_go = ""  # drivers that have begun, or let go, since

    def token(self, moment: float) -> int:
        """Return the token of a reply at `moment` [s, monotonic]."""
        return self._first + math.floor(moment / TOKEN_SECONDS)

    def live(self, moment: float) -> bool:
        """Whether its velocity counts at `moment` [s, monotonic], and is not zero."""
        return moment < self.until and self.wanted != STANDS

    def stand(self) -> None:
        """Start the next motion from rest."""
        self.velocity = STANDS

    def end(self) -> None:
        """Leave the leader to an ordered route, until a driver begins, or lets go and drives again."""
        self._ended, self._began = True, ""
        self._let_go = self.name if self.wanted == STANDS else ""

    def _takes(self, name: str, wanted: Velocity) -> bool:
        """Whether a velocity ends the route that was ordered; zero is no wish to drive, but lets go."""
        if wanted == STANDS:
            self._let_go = name
        return name == self._began or (name == self._let_go and wanted != STANDS)

    def accept(self, name: str, wanted: Velocity, returned: int, moment: float) -> Result:
        """Take a velocity, and the token that its request returned; return whether it counts, or why not.

        A request that is repeated returns the same token: it counts again, and expires with it.
        """
        if returned == 0:
            self._began = name
            return Result(ok=False, reason="the first request fetches a token", code="first")
        issued = (returned - self._first) * TOKEN_SECONDS
        if why := self._refusal(name, wanted, returned, moment, issued):
            return Result(ok=False, reason=why)
        waits = self._ended and not self._takes(name, wanted)
        self.name, self.wanted, self.newest = name, STANDS if waits else wanted, returned
        if waits:
            return Result(ok=False, reason="a route or a speed was ordered: let go, then drive again")
        self.until, self._ended = issued + DRIVE_TIMEOUT_SECONDS, False
        return Result(ok=True)

    def _refusal(self, name: str, wanted: Velocity, returned: int, moment: float, issued: float) -> str:
        """Return why a velocity does not count that returns the token `issued` then [s]; empty if it does."""
        age = moment - issued
        if not name:  # two without one would count as one driver
            return "a driver must have an id"
        if not 0.0 <= age <= DRIVE_TIMEOUT_SECONDS:
            return f"too late: it answers a reply from {age:.2f} s ago; limit {DRIVE_TIMEOUT_SECONDS:g} s"
        if moment < self.until and name != self.name:
            return f"{self.name} drives"
        # of two that return one token the release counts, as it may be the newer one
        released = returned == self.newest and self.wanted == STANDS and wanted != STANDS
        if name == self.name and (returned < self.newest or released):
            return "overtaken by a newer one"
        return ""

    def advance(self, within: Limits, dt: float, moment: float) -> Velocity:
        """Return the velocity for the next step, `dt` [s] after the one before; zero once it has expired."""
        if self.live(moment):
            self.velocity = ramped(self.velocity, followable(self.wanted, within), within, dt)
        else:
            self.stand()
        return self.velocity
