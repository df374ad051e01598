"""Protective zones: how fast may a robot go that can stop before what it sees; not in the paper.

Pure, in plain numbers. The wheels follow a command like a first-order lag, so a robot that is told `u` for
`hold` and zero from then on still goes

    lag·v + hold·u    and turns by    lag·ω + hold·ω_told

where `v` and `ω` are what it does now, however large the lag. Meanwhile its heading stays between the turns
to either side, so its centre stays in a sector of that radius and these angles, and its body in what a disc
sweeps there: the protective zone. It grows longer and thereby wider with speed, opens to the side to which
the robot turns, and lies behind it when it reverses. Where a point lies in it, `u` is less (slow), and zero
where nothing else ends before the point (stop). What is behind a robot does not keep it from leaving.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

from formation.unicycle import Command

AT_REST = Command(0.0, 0.0)
STANDS = 1e-3
"""A robot that rolls on for no more than this stands [m]."""


class Zone(StrEnum):
    """What the zones have made of a command."""

    CLEAR = "clear"
    SLOW = "slow"
    STOP = "stop"


class Body(NamedTuple):
    """What the zones are to keep clear of things."""

    radius: float
    """Of a circle around the centre that holds the body [m]."""
    margin: float
    """Of free space around it at rest [m]."""
    lag: float
    """Time constant with which it follows commands [s]."""
    spread: float = 0.05
    """It may go so far to either side of where it is told to go [rad]."""


def guarded(
    command: Command, moving: Command, seen: Sequence[complex], body: Body, hold: float
) -> tuple[Command, Zone]:
    """The command that a robot may follow for `hold` [s], and then still stop before all points seen.

    `moving` is what it does now, `seen` are points [m; body frame, now]. Only its forward speed is cut. Where
    not even zero speed will do while it turns as wanted, it is told to stop, which then is the same way
    that it could have stopped along before. Who turns round near something comes to rest first.
    """
    was, will = body.lag * moving.turn_rate, hold * command.turn_rate
    left = body.spread + max(0.0, was) + max(0.0, will)
    right = -body.spread + min(0.0, was) + min(0.0, will)
    radius, rolls, goes = body.radius + body.margin, body.lag * moving.speed, hold * command.speed
    turns_round = rolls * goes < 0.0 and abs(rolls) > STANDS
    if turns_round and all(abs(point) > radius + abs(rolls) + abs(goes) for point in seen):
        return command, Zone.CLEAR
    sign = math.copysign(1.0, moving.speed if turns_round or not command.speed else command.speed)
    stopping = max(0.0, sign * rolls)
    room = free((sign * point for point in seen), radius, right, left)
    if room < stopping:
        return AT_REST, Zone.STOP
    fastest = 0.0 if turns_round else (room - stopping) / hold
    if abs(command.speed) <= fastest:
        return command, Zone.CLEAR
    limited = math.copysign(fastest, command.speed)
    return Command(limited, command.turn_rate), Zone.SLOW if fastest > 0.0 else Zone.STOP


def free(seen: Iterable[complex], radius: float, right: float, left: float) -> float:
    """How far a circle of `radius` [m] can go before it touches a point, in the worst of its directions [m].

    Those are the angles from `right` (≤ 0) to `left` (≥ 0) [rad]. Infinite if it touches none.
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
