"""The collision filter as a whole, and what it remembers: robots that are kept from moving go another way.

Not in the paper. Who wants to move and does not for a while is kept: before something that stands, as a post
does, or because two robots wait for each other. The former goes round it, to one side and, if that does not
help, to the other. The latter turns what it wants to the right for a while (all robots do, so two pass each
other), for longer each time in a row and then to the left every other time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from formation.avoidance import Manners, Obstacle, brake, give_way
from formation.law import Limits
from formation.plane import rotation, unit
from formation.unicycle import Command, body_velocity, saturate

HELD, WANTING = 0.05, 0.15
"""Of its top speed: a robot that does less than the one though it wants more than the other is kept."""
PROGRESS, LONG = 0.1, 10.0
"""Among robots one is kept, too, that came nearer to where it wants by less than this share of its top speed,
averaged over about so long [s]: noise of positions keeps it in motion, though it trails another robot."""
LATELY = 1.0
"""Before what stands a robot may go to and fro: there counts how far it came in about so long [s]."""
PATIENCE, DETOUR = 0.5, 1.5
"""So long is a robot kept before that is a deadlock, and so long does it then go another way [s]."""
ROUND, NEAR, BEHIND, LONGEST = 1.8, 0.5, -0.2, 10.0
"""Who is kept goes at such an angle [rad] to what stands nearer than so [m], that is round it, until nothing
of that is nearer to where it wants than this cosine says; so long at most [s]."""
AGAIN, FORGET = 3.0, 6.0
"""Each time in a row as long again, but not more often; it forgets one of them while free for so long [s]."""
TO_THE_RIGHT, REPEATED = rotation(-1.2), 1.0
"""By how much that turns what it wants; kept more often than this in a row, it goes to the left every other
time: a robot that follows it may keep to its right."""


class Avoidance(NamedTuple):
    """What the filter remembers."""

    kept: float = 0.0
    """How long the robot has been kept from getting where it wants [s]."""
    detour: float = 0.0
    """How long it still goes another way [s]."""
    deadlocks: int = 0
    """How many there were."""
    went: complex = 0j
    """Velocity of its control point lately, to and fro taken together [m/s; body frame]."""
    again: float = 0.0
    """How often it was kept in a row."""
    side: float = 0.0
    """To which side it goes round what stands: 1 left, -1 right, 0 if it does not."""
    slow: float = 0.0
    """By how much more slowly than at top speed it has come nearer to where it wants lately [m/s]."""


def avoid(
    wanted: Command,
    obstacles: Sequence[Obstacle],
    manners: Manners,
    limits: Limits,
    along: complex,
    before: Avoidance,
    dt: float,
) -> tuple[Command, Avoidance]:
    """What to do instead of `wanted` (within limits) for the next `dt` [s]; the same where nothing is near.

    `along` is how the robots it follows move [m/s; body frame]: who only goes along with them is kept, too.
    """
    if len(obstacles) == 0:
        return wanted, Avoidance(0.0, 0.0, before.deadlocks, 0j, before.again, 0.0, 0.0)
    want = body_velocity(wanted.speed, wanted.turn_rate, limits.offset)
    near, ahead = _standing(obstacles, manners, want)
    side = before.side if ahead > BEHIND else 0.0  # who has it behind itself goes its own way again
    detour = before.detour if side == before.side else 0.0
    before = Avoidance(before.kept, detour, before.deadlocks, before.went, before.again, side, before.slow)
    aim = wanted
    if detour > 0.0:
        turned = near * rotation(side * ROUND) * abs(want) if side != 0.0 else _aside(before) * want
        aim = saturate(turned, limits.offset, limits.max_speed, limits.max_turn_rate)
    done = brake(give_way(aim, obstacles, manners, limits), obstacles, manners)
    return done, _remembered(want, done, near, along, limits, before, dt)


def _aside(memory: Avoidance) -> complex:
    """What turns what the robot wants for a while [–]."""
    if memory.again > REPEATED and memory.deadlocks % 2 == 1:
        return TO_THE_RIGHT.conjugate()
    return TO_THE_RIGHT


def _standing(obstacles: Sequence[Obstacle], manners: Manners, want: complex) -> tuple[complex, float]:
    """Of the things near that stand: unit vector to the nearest [body frame], 0 if there are none.

    And the greatest cosine of all of them to where the robot wants.
    """
    least, towards, ahead = NEAR + manners.radius, 0j, -1.0
    for k in range(len(obstacles)):
        one = obstacles[k]
        room, there = abs(one.at) - one.radius, unit(one.at)
        if one.stands and room < NEAR + manners.radius:
            ahead = max(ahead, (there.conjugate() * unit(want)).real)
            if room < least:
                least, towards = room, there
    return towards, ahead


def _remembered(
    want: complex,
    done: Command,
    near: complex,
    along: complex,
    limits: Limits,
    before: Avoidance,
    dt: float,
) -> Avoidance:
    """How long the robot has been kept, or still goes another way."""
    velocity = body_velocity(done.speed, done.turn_rate, limits.offset)
    share = min(1.0, dt / LATELY)
    went = before.went + share * (velocity - before.went)
    slow, wants = 0.0, abs(want - along)
    if wants > WANTING * limits.max_speed:
        slow = limits.max_speed - ((want - along).conjugate() * (velocity - along)).real / wants
    slow = before.slow + min(1.0, dt / LONG) * (slow - before.slow)
    detour = max(0.0, before.detour - dt)
    if before.detour > 0.0 and before.side == 0.0:
        return Avoidance(0.0, detour, before.deadlocks, went, before.again, 0.0, slow)
    side = before.side if detour > 0.0 else 0.0
    does = abs(went)
    if near != 0j:
        wants = abs(want)
    else:  # it stands, goes along and gets no nearer, or to and fro
        does = min(abs(velocity), abs(velocity - along))
        if limits.max_speed - slow < PROGRESS * limits.max_speed:
            does = 0.0
    if does >= HELD * limits.max_speed or wants <= WANTING * limits.max_speed:
        again = before.again
        if near != 0j or slow < (1.0 - PROGRESS) * limits.max_speed:
            again = max(0.0, again - dt / FORGET)
        return Avoidance(max(0.0, before.kept - dt), detour, before.deadlocks, went, again, side, slow)
    if before.kept + dt <= PATIENCE:
        return Avoidance(before.kept + dt, detour, before.deadlocks, went, before.again, side, slow)
    again = min(AGAIN, before.again + 1.0)
    if near != 0j:
        left = near.real * want.imag - near.imag * want.real >= 0.0
        other = -side if side != 0.0 else (1.0 if left else -1.0)
        return Avoidance(0.0, LONGEST, before.deadlocks + 1, went, again, other, slow)
    detour = DETOUR * (1.0 + before.again)
    return Avoidance(0.0, detour, before.deadlocks + 1, went, again, 0.0, slow)
