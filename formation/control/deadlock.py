"""The whole collision filter and its state: a blocked robot takes another direction.

Not in the paper. A robot that wants to move and does not for a while is blocked: by a standing obstacle
such as a post, or because two robots wait for each other. In the first case it goes round the obstacle, to
one side and, if that does not help, to the other. In the second case it turns its wanted velocity to the
right for a while (all robots do, so two pass each other), longer each time in a row, and then to the left
every other time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from formation.control.avoidance import AvoidanceParameters, Obstacle, brake, give_way
from formation.control.controller import Limits
from formation.control.plane import rotation, unit
from formation.control.unicycle import Command, body_velocity, saturate

MAX_BLOCKED_SHARE, MIN_WANTED_SHARE = 0.05, 0.15
"""Shares of the top speed: a robot that moves slower than the first and wants more than the second is
blocked."""
MIN_PROGRESS_SHARE, LONG_PROGRESS_TIME = 0.1, 10.0
"""Among robots it is also blocked if its progress is below this share of its top speed, averaged over
about this time [s]: noise of positions keeps it in motion, though it trails another robot."""
PROGRESS_TIME = 1.0
"""Time over which progress is averaged at a standing obstacle, where a robot may go to and fro [s]."""
DEADLOCK_DELAY, DETOUR_TIME = 0.5, 1.5
"""Time after which a blocked robot is in a deadlock, and length of its detour [s]."""
DETOUR_ANGLE, DETOUR_DISTANCE, MIN_DETOUR_COSINE, MAX_DETOUR_TIME = 1.8, 0.5, -0.2, 10.0
"""A detour round a standing obstacle: angle to it [rad], distance within which it counts [m], cosine
between it and the wanted direction below which the detour ends, and longest duration [s]."""
MAX_DETOUR_REPEATS, FORGETTING_TIME = 3.0, 6.0
"""Most repetitions by which a detour gets longer, and free time after which one of them is forgotten [s]."""
TO_THE_RIGHT, REPEATED = rotation(-1.2), 1.0
"""Rotation of the wanted velocity; a robot blocked more often than this in a row turns left every other
time, because a robot that follows it may keep to its right."""


class Avoidance(NamedTuple):
    """The filter's state."""

    kept: float = 0.0
    """How long the robot has been blocked [s]."""
    detour: float = 0.0
    """Remaining time of the detour [s]."""
    deadlocks: int = 0
    """Number of deadlocks."""
    went: complex = 0j
    """Mean recent velocity of its control point [m/s; body frame]."""
    again: float = 0.0
    """Number of times that it was blocked in a row."""
    side: float = 0.0
    """Side on which it passes a standing obstacle: 1 left, -1 right, 0 if it does not."""
    slow: float = 0.0
    """Mean recent difference of its progress from its top speed [m/s]."""


def avoid(
    wanted: Command,
    obstacles: Sequence[Obstacle],
    parameters: AvoidanceParameters,
    limits: Limits,
    along: complex,
    before: Avoidance,
    dt: float,
) -> tuple[Command, Avoidance]:
    """The command for the next `dt` [s] instead of `wanted` (within limits); the same if nothing is near.

    `along` is the velocity of the robots it follows [m/s; body frame]: a robot that only moves along with
    them is blocked, too.
    """
    if len(obstacles) == 0:
        return wanted, Avoidance(0.0, 0.0, before.deadlocks, 0j, before.again, 0.0, 0.0)
    want = body_velocity(wanted.speed, wanted.turn_rate, limits.offset)
    near, ahead = _standing(obstacles, parameters, want)
    side = before.side if ahead > MIN_DETOUR_COSINE else 0.0  # once it is behind, the detour ends
    detour = before.detour if side == before.side else 0.0
    before = Avoidance(before.kept, detour, before.deadlocks, before.went, before.again, side, before.slow)
    aim = wanted
    if detour > 0.0:
        turned = near * rotation(side * DETOUR_ANGLE) * abs(want) if side != 0.0 else _aside(before) * want
        aim = saturate(turned, limits.offset, limits.max_speed, limits.max_turn_rate)
    done = brake(give_way(aim, obstacles, parameters, limits), obstacles, parameters)
    return done, _updated(want, done, near, along, limits, before, dt)


def _aside(state: Avoidance) -> complex:
    """Rotation of the wanted velocity during a detour [–]."""
    if state.again > REPEATED and state.deadlocks % 2 == 1:
        return TO_THE_RIGHT.conjugate()
    return TO_THE_RIGHT


def _standing(
    obstacles: Sequence[Obstacle], parameters: AvoidanceParameters, want: complex
) -> tuple[complex, float]:
    """Unit vector to the nearest standing obstacle near the robot [body frame], 0 if there is none.

    And the greatest cosine of all of them to the wanted direction.
    """
    least, towards, ahead = DETOUR_DISTANCE + parameters.radius, 0j, -1.0
    for k in range(len(obstacles)):
        one = obstacles[k]
        room, there = abs(one.at) - one.radius, unit(one.at)
        if one.stands and room < DETOUR_DISTANCE + parameters.radius:
            ahead = max(ahead, (there.conjugate() * unit(want)).real)
            if room < least:
                least, towards = room, there
    return towards, ahead


def _updated(
    want: complex,
    done: Command,
    near: complex,
    along: complex,
    limits: Limits,
    before: Avoidance,
    dt: float,
) -> Avoidance:
    """Update how long the robot has been blocked, or its detour lasts."""
    velocity = body_velocity(done.speed, done.turn_rate, limits.offset)
    share = min(1.0, dt / PROGRESS_TIME)
    went = before.went + share * (velocity - before.went)
    slow, wants = 0.0, abs(want - along)
    if wants > MIN_WANTED_SHARE * limits.max_speed:
        slow = limits.max_speed - ((want - along).conjugate() * (velocity - along)).real / wants
    slow = before.slow + min(1.0, dt / LONG_PROGRESS_TIME) * (slow - before.slow)
    detour = max(0.0, before.detour - dt)
    if before.detour > 0.0 and before.side == 0.0:
        return Avoidance(0.0, detour, before.deadlocks, went, before.again, 0.0, slow)
    side = before.side if detour > 0.0 else 0.0
    does = abs(went)
    if near != 0j:
        wants = abs(want)
    else:  # it stands, only moves along with others, or goes to and fro
        does = min(abs(velocity), abs(velocity - along))
        if limits.max_speed - slow < MIN_PROGRESS_SHARE * limits.max_speed:
            does = 0.0
    if does >= MAX_BLOCKED_SHARE * limits.max_speed or wants <= MIN_WANTED_SHARE * limits.max_speed:
        again = before.again
        if near != 0j or slow < (1.0 - MIN_PROGRESS_SHARE) * limits.max_speed:
            again = max(0.0, again - dt / FORGETTING_TIME)
        return Avoidance(max(0.0, before.kept - dt), detour, before.deadlocks, went, again, side, slow)
    if before.kept + dt <= DEADLOCK_DELAY:
        return Avoidance(before.kept + dt, detour, before.deadlocks, went, before.again, side, slow)
    again = min(MAX_DETOUR_REPEATS, before.again + 1.0)
    if near != 0j:
        left = near.real * want.imag - near.imag * want.real >= 0.0
        other = -side if side != 0.0 else (1.0 if left else -1.0)
        return Avoidance(0.0, MAX_DETOUR_TIME, before.deadlocks + 1, went, again, other, slow)
    detour = DETOUR_TIME * (1.0 + before.again)
    return Avoidance(0.0, detour, before.deadlocks + 1, went, again, 0.0, slow)
