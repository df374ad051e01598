"""Driving by hand: velocities that a driver sends again and again, each of which expires soon.

Each reply of the leader has a *token*, its own monotonic clock [ms]. A velocity must return the token of a
reply: the leader accepts it within `DRIVE_TIMEOUT_SECONDS` of that reply, and moves by it no longer than
that. So however late, repeated or recorded a message is, and whatever a clock says, the leader stands at most
`DRIVE_TIMEOUT_SECONDS` after the driver's newest input. The first request of a driver has no token and moves
nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from formation.control.plane import clip
from formation.mission.model import Mission
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.stability.intent import SLOT_SPEED_SHARE

RAMP_SECONDS = 0.5
"""Shortest time from rest to the limit of the driven speed or turn rate [s]."""
SPEED_SHARE = 0.8
"""Greatest driven speed, as a share of the slowest follower's limit: the rest is for closing errors."""
RADIUS_SHARE = 1.5
"""Smallest radius that is driven, as a ratio to the smallest that followers can follow."""
TOKEN_SECONDS = 1e-3
"""Unit of a token [s]."""


class Velocity(NamedTuple):
    """Velocity of the leader's point."""

    forward: float = 0.0
    """Along its heading; negative: backwards [m/s]."""
    turn_rate: float = 0.0
    """Counter-clockwise [rad/s]."""


STANDS = Velocity()


class Limits(NamedTuple):
    """What the followers of a mission can follow."""

    speed: float
    """[m/s]"""
    turn_rate: float
    """While the leader stands [rad/s]."""
    radius: float
    """Smallest radius of its path [m]."""
    swing: float
    """Distance from the leader of the farthest slot that turns with it [m]; 0 if none does."""
    top_speed: float
    """The slowest follower's limit [m/s]."""


def limits(mission: Mission, slots: Iterable[complex]) -> Limits:
    """Return the limits for followers in `slots` relative to the leader [m]."""
    robots = [mission.robots[name] for name in mission.followers]
    slowest = min(robot.max_speed for robot in robots)
    turn_rate = min(robot.max_turn_rate for robot in robots)
    return Limits(
        speed=SPEED_SHARE * slowest,
        turn_rate=SPEED_SHARE * turn_rate,
        radius=RADIUS_SHARE * max(robot.control_point_offset for robot in robots),
        swing=max((abs(slot) for slot in slots), default=0.0) if mission.turning else 0.0,
        top_speed=slowest,
    )


def followable(wanted: Velocity, within: Limits) -> Velocity:
    """Return the velocity nearest to `wanted` that the followers can follow; speed has priority."""
    forward = clip(wanted.forward, within.speed)
    most = within.turn_rate
    if forward != 0.0:
        most = min(most, abs(forward) / within.radius)
    if within.swing > 0.0:
        most = min(most, SLOT_SPEED_SHARE * (within.top_speed - abs(forward)) / within.swing)
    return Velocity(forward, clip(wanted.turn_rate, most))


def ramped(before: Velocity, wanted: Velocity, within: Limits, dt: float) -> Velocity:
    """Return the velocity `dt` [s] after `before` on the way to `wanted`."""
    share = min(dt / RAMP_SECONDS, 1.0)

    def nearer(start: float, end: float, limit: float) -> float:
        return start + clip(end - start, share * limit)

    return Velocity(
        nearer(before.forward, wanted.forward, within.speed),
        nearer(before.turn_rate, wanted.turn_rate, within.turn_rate),
    )


def token(moment: float) -> int:
    """Return the token of a reply at `moment` [s, monotonic]."""
    return math.floor(moment / TOKEN_SECONDS)


class Driver:
    """The driver of one leader: its newest accepted velocity, and until when that counts."""

    def __init__(self) -> None:
        self.name = ""
        """Id of the driver; empty before the first."""
        self.wanted = STANDS
        self.velocity = STANDS
        """The ramped one."""
        self.until = -math.inf
        """When it expires [s, monotonic]."""
        self.newest = 0
        """Newest token that was returned."""

    def live(self, moment: float) -> bool:
        """Whether its velocity counts at `moment` [s, monotonic], and is not zero."""
        return moment < self.until and self.wanted != STANDS

    def stand(self) -> None:
        """Start the next motion from rest."""
        self.velocity = STANDS

    def accept(self, name: str, wanted: Velocity, returned: int, moment: float) -> str:
        """Take a velocity, and the token that its request returned; return why it does not count, or "".

        A request that is repeated returns the same token: it counts again, and expires with it.
        """
        issued = returned * TOKEN_SECONDS
        age = moment - issued
        if returned == 0:
            return "its first request: now send velocities with the token of this reply"
        if not 0.0 <= age <= DRIVE_TIMEOUT_SECONDS:
            return f"too late: it answers a reply from {age:.2f} s ago; limit {DRIVE_TIMEOUT_SECONDS:g} s"
        if moment < self.until and name != self.name:
            return f"{self.name} drives"
        if name == self.name and returned < self.newest:
            return "overtaken by a newer one"
        self.name, self.wanted, self.newest = name, wanted, returned
        self.until = issued + DRIVE_TIMEOUT_SECONDS
        return ""

    def advance(self, within: Limits, dt: float, moment: float) -> Velocity:
        """Return the velocity for the next step, `dt` [s] after the one before; zero once it has expired."""
        if self.live(moment):
            self.velocity = ramped(self.velocity, followable(self.wanted, within), within, dt)
        else:
            self.stand()
        return self.velocity
