"""The collision filter: what stands between the law and the command, so that bodies do not meet.

Not in the paper. Three layers, the third in `formation.detour`, where they are put together; each leaves a
command alone that it has nothing against (docs/decisions/0039-out-of-each-others-way.md has the proof of the
brake and what was measured):

1. Right of way. A half-plane for each obstacle bounds how fast the front of the body may come nearer to it.
   Who does not have right of way gets out of the way; who has it minds only its distance. What is done is
   what is nearest to what is wanted within all half-planes and limits.
2. The brake. In the time that a command may last a robot uses up at most half of the room that there is
   between two bodies, and the other robot at most the other half. So they never touch.
3. Deadlocks. A robot that is kept from moving goes another way for a while.

| symbol | here | meaning | unit |
|---|---|---|---|
| u + i p ω | `velocity` | velocity of a point p ahead, body frame | m/s |
| d | `room` | distance between two bodies, less the margin | m |
| n | `towards` | unit vector to the obstacle, body frame | – |
| T | `hold` | longest time that a command may last | s |
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from formation.law import Limits
from formation.plane import rotation, unit
from formation.unicycle import Command, body_velocity, saturate

YIELDING, PASSING = 4.0, 8.0
"""How fast the room to an obstacle may shrink, as a share of it: who yields, and who passes first [1/s]."""
RETREAT = 1.0 / 3.0
"""Nobody backs out of the way faster than this share of its top speed."""
SHARPER = 20.0
"""The filter learns the heading so many times faster than the law does: a guess is no use to it."""
SLACK = 0.05
"""And may still be so wrong about it [rad]."""
STEADY = 0.02
"""Standard deviation that noise of positions may leave in the heading that is learned in the end [rad]."""
FADING = 3.0
"""Until then the gain is this over the way [–]."""
PAIR_DEVIATIONS = 4.0
"""So many standard deviations of the distance between two robots are kept free."""
DEVIATIONS = 2.0
"""So many standard deviations of the noise are expected."""
AGEING = 1.5
"""So many times the age of what is known of another robot counts like time that a command lasts."""
LAG = 4.0
"""So many times the time constant with which robots follow commands counts like time that a command lasts."""
NEGLIGIBLE = 1e-12
"""Below what anything can measure; more than rounding makes of a bound that is kept [m/s]."""


class Obstacle(NamedTuple):
    """Something round that a robot must not touch."""

    at: complex
    """Its centre relative to the robot's centre [m; body frame]."""
    radius: float
    """[m]"""
    velocity: complex
    """[m/s; body frame]"""
    first: bool
    """Whether it has right of way."""
    stands: bool = False
    """Whether it will be there for ever: it is gone round and not waited for."""
    doubt: float = 0.0
    """By how much its direction may be off [rad]; from π on nothing is known of that."""
    age: float = 0.0
    """How long ago it was there [s]; what it did since is bounded by its own brake."""
    unsure: float = 0.0
    """How far aside of `at` it may be by now [m]."""


class Manners(NamedTuple):
    """How a robot keeps clear of others."""

    radius: float
    """Of its own body [m]."""
    margin: float
    """Room that is left between two bodies [m]."""
    hold: float
    """Longest time that a command may last, and the robot take to follow it [s]."""
    blind: float = 0.0
    """Room that is left while the robot does not know its heading [m]: at most the margin."""


class HalfPlane(NamedTuple):
    """x v + y w <= most, for the velocity v + i w of a point ahead, at first the front [m/s; body frame]."""

    x: float
    y: float
    most: float


def give_way(wanted: Command, obstacles: Sequence[Obstacle], manners: Manners, limits: Limits) -> Command:
    """The command nearest to `wanted` that leaves everybody the right of way.

    Nearest for the control point, for who is in the way goes on by itself, and the law knows best where to
    wait. Nearest for the front where something stands: a control point further ahead than that is drawn past
    it, and turns the robot back to it for ever.
    """
    bounds = [half_plane(obstacles[k], manners, limits) for k in range(len(obstacles))]
    lever, scale = front(manners, limits), limits.offset
    velocity, free = body_velocity(wanted.speed, wanted.turn_rate, lever), True
    for k in range(len(bounds)):
        bound = bounds[k]
        if bound.x * velocity.real + bound.y * velocity.imag > bound.most + NEGLIGIBLE:
            free = False
            scale = lever if obstacles[k].stands else scale
    if free:  # the very same, to the last bit
        return wanted
    bounds = [HalfPlane(bound.x, bound.y * lever / scale, bound.most) for bound in bounds]
    sideways = scale * limits.max_turn_rate
    bounds.append(HalfPlane(1.0, 0.0, limits.max_speed))
    bounds.append(HalfPlane(-1.0, 0.0, limits.max_speed))
    bounds.append(HalfPlane(0.0, 1.0, sideways))
    bounds.append(HalfPlane(0.0, -1.0, sideways))
    velocity = body_velocity(wanted.speed, wanted.turn_rate, scale)
    found, point = nearest(velocity, bounds)
    if not found:  # not all can be left as much as they ask for; that nobody is approached can always be
        patient = [HalfPlane(bound.x, bound.y, max(bound.most, 0.0)) for bound in bounds]
        _, point = nearest(velocity, patient)
    return saturate(point, scale, limits.max_speed, limits.max_turn_rate)


def front(manners: Manners, limits: Limits) -> float:
    """How far ahead of the centre the point is whose velocity is bounded [m]."""
    return min(manners.radius, limits.offset)


def half_plane(obstacle: Obstacle, manners: Manners, limits: Limits) -> HalfPlane:
    """How fast the front of the body may come nearer to an obstacle; a disc around it holds the body."""
    lever = front(manners, limits)
    away = obstacle.at - lever
    distance, towards = abs(away), unit(away)
    room = distance - (lever + manners.radius + obstacle.radius + obstacle.unsure + manners.margin)
    most = PASSING * room
    if obstacle.first:
        velocity = obstacle.velocity
        most = YIELDING * room + towards.real * velocity.real + towards.imag * velocity.imag
    return HalfPlane(towards.real, towards.imag, max(most, -RETREAT * limits.max_speed))


def nearest(wanted: complex, bounds: list[HalfPlane]) -> tuple[bool, complex]:
    """Whether half-planes have points in common, and which of these is nearest to `wanted`.

    If not that itself it lies on an edge: the nearest point of each line, cut to what the others leave of it.
    """
    best, least, within = 0j, math.inf, True
    for i in range(len(bounds)):
        edge = bounds[i]
        squared = edge.x * edge.x + edge.y * edge.y
        beyond = edge.x * wanted.real + edge.y * wanted.imag - edge.most
        if beyond < 0.0 or squared < NEGLIGIBLE:
            continue
        within = False
        foot = wanted - complex(edge.x, edge.y) * (beyond / squared)
        along = complex(-edge.y, edge.x)
        low, high = -math.inf, math.inf
        for j in range(len(bounds)):
            if j == i:
                continue
            other = bounds[j]
            slope = other.x * along.real + other.y * along.imag
            left = other.most - other.x * foot.real - other.y * foot.imag
            if abs(slope) < NEGLIGIBLE:
                high = high if left >= -NEGLIGIBLE else -math.inf
            elif slope > 0.0:
                high = min(high, left / slope)
            else:
                low = max(low, left / slope)
        if low > high + NEGLIGIBLE:
            continue
        point = foot + max(low, min(high, 0.0)) * along
        distance = abs(point - wanted)
        if distance < least:
            best, least = point, distance
    return within or least < math.inf, wanted if within else best


def brake(wanted: Command, obstacles: Sequence[Obstacle], manners: Manners) -> Command:
    """`wanted`, its speed cut so that no obstacle comes nearer by more than half of the room in `hold` [s].

    However long the command lasts up to then: the robot turns meanwhile, and what counts is when it faces
    the obstacle most. Standing still, and turning on the spot, are always allowed. Towards what may be in
    any direction it goes no faster than if it were ahead, and leaves no margin: to find out needs room.
    """
    low, high = -math.inf, math.inf
    for k in range(len(obstacles)):
        one = obstacles[k]
        distance, blind = abs(one.at), one.doubt >= math.pi
        room = distance - (manners.radius + one.radius + (manners.blind if blind else manners.margin))
        most = max(0.0, 0.5 * room / (manners.hold + AGEING * one.age))
        doubt = one.doubt
        if one.unsure > 0.0:
            doubt += math.asin(min(1.0, one.unsure / distance)) if distance > 0.0 else math.pi
        least, greatest = facing(unit(one.at), wanted.turn_rate * manners.hold, doubt)
        if greatest > 0.0:
            high = min(high, most / greatest)
        if least < 0.0:
            low = max(low, most / least)
    if low <= wanted.speed <= high:
        return wanted
    return Command(max(low, min(high, wanted.speed)), wanted.turn_rate)


def facing(towards: complex, turn: float, doubt: float) -> tuple[float, float]:
    """Least and greatest cosine between the heading and `towards` while the robot turns by `turn` [rad].

    `doubt` [rad] is how far off `towards` may be, to either side.
    """
    spread = 0.5 * abs(turn) + doubt
    if spread >= math.pi:
        return -1.0, 1.0
    ahead = towards * rotation(-0.5 * turn)
    middle = abs(math.atan2(ahead.imag, ahead.real))
    return math.cos(min(math.pi, middle + spread)), math.cos(max(0.0, middle - spread))


def margin_kept(margin: float, noise: float) -> float:
    """Room to keep between two bodies [m]; `noise` is the standard deviation of a position per axis [m]."""
    return max(margin, PAIR_DEVIATIONS * math.sqrt(2.0) * noise)


def course_gain(travelled: float, gain: float, noise: float) -> float:
    """Gain of the filter's own heading observer after `travelled` [m], from `gain` on [1/m].

    It falls as the robot moves, to where `noise` [m] of positions does not matter any more.
    """
    return max(_least_gain(gain, noise), gain * FADING / (FADING + gain * travelled))


def heading_doubt(travelled: float, gain: float, noise: float) -> float:
    """By how much that observer may be wrong about the heading after so long a way [rad].

    |ζ̂ - ζ| <= 2 e^{-∫k} whatever the first guess was, and some k·noise besides, where k is `course_gain`.
    """
    least = _least_gain(gain, noise)
    fading = min(travelled, FADING / least - FADING / gain)
    kept = (1.0 + gain * fading / FADING) ** -FADING * math.exp(-least * (travelled - fading))
    wrong, shaken = 2.0 * kept, DEVIATIONS * noise * course_gain(travelled, gain, noise)
    return max(SLACK, shaken) + math.asin(wrong) if wrong + shaken < 1.0 else math.pi


def _least_gain(gain: float, noise: float) -> float:
    return gain if noise * gain <= STEADY else STEADY / noise
