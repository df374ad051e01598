"""Protective zones: limit a robot's speed so that it can stop before what it sees; not in the paper.

Pure, in plain numbers. The wheels follow a command like a first-order lag, so a robot that is commanded
`u` for `hold` and zero from then on still moves

    lag·v + hold·u    and turns by    lag·ω + hold·ω_command

where `v` and `ω` are its present speeds, however large the lag. Meanwhile its heading stays between the
turns to either side, so its centre stays in a sector of that radius and these angles, and its body in what
a disc sweeps there: the protective zone. It grows longer and thereby wider with speed, opens to the side
to which the robot turns, and lies behind it when it reverses. If it contains a point, `u` is reduced
(slow), to zero if nothing else ends before the point (stop). Points behind a robot do not keep it from
leaving. A robot does not drive in directions that its scanner does not see.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

from formation.control.unicycle import AT_REST, Command

STANDSTILL_DISTANCE = 1e-3
"""Stopping distance up to which a robot counts as standing [m]."""
MIN_VIEW_ANGLE = math.radians(45.0)
"""Angle to either side of its way that a robot must see [rad]: nothing that it would touch leaves that view
before the zone stops the robot."""


class Zone(StrEnum):
    """What the protective zone does to a command."""

    CLEAR = "clear"
    """The command is not changed."""
    SLOW = "slow"
    """The forward speed is reduced."""
    STOP = "stop"
    """The robot stops, or only turns."""


class Body(NamedTuple):
    """The body that the zones protect."""

    radius: float
    """Radius of the circle around the centre that contains the body [m]."""
    margin: float
    """Width of the free space around it at rest [m]."""
    lag: float
    """Time constant with which it follows commands [s]."""
    spread: float = 0.05
    """Possible deviation from the commanded direction, to either side [rad]."""


class Sight(NamedTuple):
    """Points seen by a scanner, and its robot's motion."""

    moving: Command
    """The robot's present speeds."""
    points: Sequence[complex]
    """Points that it must not touch [m; body frame, now]."""
    body: Body
    hold: float
    """Longest time that a command may last [s]."""
    unseen: Sequence[complex] = ()
    """Directions that its scanner does not see, unit [body frame]."""


def guarded(
    command: Command,
    moving: Command,
    seen: Sequence[complex],
    body: Body,
    hold: float,
    unseen: Sequence[complex] = (),
) -> tuple[Command, Zone]:
    """Return a command that a robot may follow for `hold` [s], and then still stop before all points seen.

    `moving` are its present speeds, `seen` are points [m; body frame, now], `unseen` directions that no
    beam covers, unit [body frame]: there is no room towards them. Only its forward speed is reduced. If
    even zero speed is not enough while it turns as wanted, it is commanded to stop, which then is the path
    on which it could have stopped before. A robot that turns round near an obstacle thus stops first.
    """
    was, will = body.lag * moving.turn_rate, hold * command.turn_rate
    left = body.spread + max(0.0, was) + max(0.0, will)
    right = -body.spread + min(0.0, was) + min(0.0, will)
    radius, rolls, goes = body.radius + body.margin, body.lag * moving.speed, hold * command.speed
    turns_round = rolls * goes < 0.0 and abs(rolls) > STANDSTILL_DISTANCE
    if turns_round and not unseen and all(abs(point) > radius + abs(rolls) + abs(goes) for point in seen):
        return command, Zone.CLEAR
    sign = math.copysign(1.0, moving.speed if turns_round or not command.speed else command.speed)
    stopping = max(0.0, sign * rolls)
    towards = (_beside(sign * one, right, left) for one in unseen)
    blind = any(angle <= MIN_VIEW_ANGLE for angle in towards)
    room = 0.0 if blind else free((sign * point for point in seen), radius, right, left)
    if room < stopping:
        return AT_REST, Zone.STOP
    fastest = 0.0 if turns_round else (room - stopping) / hold
    if abs(command.speed) <= fastest:
        return command, Zone.CLEAR
    limited = math.copysign(fastest, command.speed)
    return Command(limited, command.turn_rate), Zone.SLOW if fastest > 0.0 else Zone.STOP


def _beside(direction: complex, right: float, left: float) -> float:
    """Angle from a direction to the nearest of those from `right` (≤ 0) to `left` (≥ 0) [rad]."""
    bearing = math.atan2(direction.imag, direction.real)
    return max(0.0, bearing - left, right - bearing)


def free(seen: Iterable[complex], radius: float, right: float, left: float) -> float:
    """How far a circle of `radius` [m] can move before it touches a point, in its worst direction [m].

    Directions are the angles from `right` (≤ 0) to `left` (≥ 0) [rad]. Infinite if it touches none.
    """
    room = math.inf
    everywhere = max(left, -right) >= 0.5 * math.pi
    for point in seen:
        distance = abs(point)
        if distance - radius >= room:
            continue
        bearing = math.atan2(point.imag, point.real)
        off = 0.0 if everywhere else bearing - min(max(bearing, right), left)
        ahead, aside = distance * math.cos(off), distance * math.sin(off)
        if ahead > 0.0 and abs(aside) < radius:
            room = min(room, max(0.0, ahead - math.sqrt(radius * radius - aside * aside)))
    return room
