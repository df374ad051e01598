"""Driving by hand: velocities that a driver sends again and again, each of which expires soon.

Each reply of the leader has a *token*: its own monotonic clock [ms], plus a number that depends on its
process. A velocity must return the token of a reply: the leader accepts it within `DRIVE_TIMEOUT_SECONDS` of
that reply, and moves by it no longer than that. So however late, repeated or recorded a message is, and
whatever a clock says, the leader stands at most `DRIVE_TIMEOUT_SECONDS` after the driver's newest input. The
number makes tokens of another process invalid, even if the two clocks are equal. The first request of a
driver has no token and moves nothing.

A driver must first let go, that is send zero, if it was refused because another drives or the fleet is held,
if a speed or a route was ordered while it drove, or if it drove before this leader led.
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
"""Time since a driver's newest velocity other than zero after which another may drive [s]."""
MAX_DRIVERS = 16
"""Number of drivers that are remembered; one that was forgotten must let go first."""
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
class _KnownDriver:
    """What this leader knows of one driver."""

    is_new: bool
    """Whether its first request here had no token, and it has not been refused since."""
    may_drive: bool = False
    """Whether it has let go, or driven, since it was last refused."""
    released: bool = False
    """Whether its newest velocity is zero."""
    newest: int = 0
    """Newest token that it has returned."""

    def outdated(self, wanted: Velocity, returned: int, age: float) -> str:
        """Return why a velocity is too old that returns a token of `age` [s]; empty if it is not."""
        if not 0.0 <= age <= DRIVE_TIMEOUT_SECONDS:
            self.is_new = False  # its token is not that of its first reply
            return f"too late: it answers a reply from {age:.2f} s ago; limit {DRIVE_TIMEOUT_SECONDS:g} s"
        # of two velocities with one token zero counts, as it may be the newer one
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
        self._ended = False  # whether a route was ordered, and no driver has moved the leader since
        self._moved = moved  # when a velocity other than zero was last accepted [s, monotonic]
        self._known: dict[str, _KnownDriver] = {}  # by id, the newest at the end

    def token(self, moment: float) -> int:
        """Return the token of a reply at `moment` [s, monotonic]."""
        return self._first + math.floor(moment / TOKEN_SECONDS)

    def live(self, moment: float) -> bool:
        """Whether an accepted velocity other than zero is in force at `moment` [s, monotonic]."""
        return moment < self.until and self.wanted != STANDS

    def drives(self, moment: float) -> bool:
        """Whether a velocity other than zero was accepted lately, at `moment` [s, monotonic]."""
        return moment - self._moved < IDLE_SECONDS

    def stand(self) -> None:
        """Start the next motion from rest."""
        self.velocity = STANDS

    def end(self) -> None:
        """Note that a route was ordered: drivers must let go before they drive again; a new one may begin."""
        self._ended, self.until = True, -math.inf
        for driver in self._known.values():
            driver.is_new, driver.may_drive = False, driver.released

    def accept(
        self, name: str, wanted: Velocity, returned: int, moment: float, refusal: Result | None = None
    ) -> Result:
        """Accept a velocity that arrived at `moment` [s, monotonic] with the token `returned`, or refuse it.

        `refusal` is why none is accepted now, such as a hold. A copy of a request has the same token, so it
        is accepted no longer than the request itself.
        """
        if not name:  # two drivers without an id would look like one
            return Result(ok=False, reason="a driver must have an id")
        driver = self._known_driver(name, is_new=returned == 0)
        if returned == 0:
            return refusal or Result(ok=False, reason="the first request fetches a token", code="first")
        issued = (returned - self._first) * TOKEN_SECONDS
        if why := driver.outdated(wanted, returned, moment - issued):
            return refusal or Result(ok=False, reason=why)
        driver.newest, driver.released = returned, wanted == STANDS
        driver.may_drive = driver.may_drive or driver.released
        if refusal is None and (why := self._refusal(name, driver, moment)):
            refusal = Result(ok=False, reason=why)
        if refusal is not None:
            if not driver.released:
                driver.is_new = driver.may_drive = False
            return refusal
        driver.may_drive, self._ended = True, False
        self.name, self.wanted, self.until = name, wanted, issued + DRIVE_TIMEOUT_SECONDS
        if not driver.released:
            self._moved = moment
        return Result(ok=True)

    def _known_driver(self, name: str, *, is_new: bool) -> _KnownDriver:
        """Return what is known of a driver; `is_new` is for one that is not known yet."""
        driver = self._known[name] = self._known.pop(name, _KnownDriver(is_new))
        if len(self._known) > MAX_DRIVERS:
            del self._known[next(iter(self._known))]
        return driver

    def _refusal(self, name: str, driver: _KnownDriver, moment: float) -> str:
        """Return why the newest velocity of a driver is refused; empty if it is not."""
        other = name != self.name and moment < self.until
        if other and self.drives(moment):
            return f"{self.name} drives"
        if driver.is_new and not other:
            return ""
        if not driver.may_drive:
            return f"{ORDERED if self._ended else ''}{LET_GO}"
        # zero does not end an ordered route: the driver may only have let go
        return f"{ORDERED}{LET_GO}" if self._ended and driver.released else ""

    def advance(self, within: Limits, dt: float, moment: float) -> Velocity:
        """Return the velocity for the next step, `dt` [s] after the one before; zero once it has expired."""
        if self.live(moment):
            self.velocity = ramped(self.velocity, followable(self.wanted, within), within, dt)
        else:
            self.stand()
        return self.velocity
