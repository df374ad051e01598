"""The collision filter: changes the law's command so that bodies do not collide.

Not in the paper. Three layers, combined in `avoid`; each passes on unchanged a command that violates nothing
(docs/decisions/0039-collision-filter.md has the proof of the brake and the measurements):

1. Right of way. A half-plane for each obstacle bounds how fast the front of the body may approach it. A robot
   without right of way gets out of the way; one that has it only keeps its distance. The command is the
   nearest to the wanted one within all half-planes and limits.
2. The brake. In the time that a command may last a robot uses at most half of the room between two bodies,
   and the other robot at most the other half. So they never touch, if both get commands at the same moments;
   with a rhythm of their own, and wheels that lag, under the conditions that the decision names.
3. Deadlocks. A robot that wants to move and does not for a while is blocked: by a standing obstacle such as
   a post, or because two robots wait for each other. In the first case it goes round the obstacle, to one
   side and, if that does not help, to the other. In the second case it turns its wanted velocity to the right
   for a while, and rarely to the left: all robots do, so two pass each other.

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

from formation.control.controller import Limits
from formation.control.plane import rotation, unit
from formation.control.unicycle import Command, body_velocity, saturate

MAX_APPROACH_RATE = 8.0
"""Greatest relative rate at which the room to an obstacle may shrink [1/s]."""
MAX_RETREAT_SHARE = 0.2
"""Greatest speed for backing out of the way, as a share of the top speed."""
HEADING_GAIN_RATIO = 20.0
"""Ratio of the filter's heading gain to the law's: the filter cannot use a guess."""
MAX_HEADING_ERROR = 0.05
"""Remaining error of that heading [rad]."""
LEARNED_HEADING_DEVIATION = 0.02
"""Standard deviation of the learned heading due to noise of positions, in the end [rad]."""
FADED_GAIN = 3.0
"""The gain falls to this over the distance travelled [–]."""
REVERSING_TIME = 0.2
"""Time at top speed for which it must be free behind a robot that reverses [s]."""
PAIR_DEVIATIONS = 4.0
"""Standard deviations of the distance between two robots that are kept free."""
NOISE_DEVIATIONS = 2.0
"""Standard deviations of the noise that are expected."""
AGE_WEIGHT = 1.5
"""Weight of the age of another robot's data in the time that a command lasts."""
BOUND_TOLERANCE = 1e-12
"""Tolerance of a bound: below any measurement, above rounding [m/s]."""
MAX_BLOCKED_SHARE, MIN_WANTED_SHARE = 0.05, 0.15
"""Shares of the top speed: a robot that moves slower than the first and wants more than the second is
blocked."""
MIN_PROGRESS_SHARE, LONG_PROGRESS_TIME = 0.1, 4.0
"""Among robots it is also blocked if its progress is below this share of its top speed, averaged over
about this time [s]: noise of positions, or late braking, keeps it in motion, though it trails another."""
PROGRESS_TIME = 1.0
"""Time over which progress is averaged at a standing obstacle, where a robot may go to and fro [s]."""
DEADLOCK_DELAY, DETOUR_TIME = 0.5, 2.5
"""Time after which a blocked robot is in a deadlock, and length of its detour [s]."""
DETOUR_ANGLE, DETOUR_DISTANCE, MIN_DETOUR_COSINE, MAX_DETOUR_TIME = 1.8, 0.5, -0.2, 10.0
"""A detour round a standing obstacle: angle to it [rad], distance within which it counts [m], cosine
between it and the wanted direction below which the detour ends, and longest duration [s]."""
TO_THE_RIGHT, LEFT_EVERY = rotation(-1.2), 6
"""Rotation of the wanted velocity during a detour, the same for all robots, or two would turn to one side. A
robot's fifth detour, and each sixth after it, goes to the left: one that follows it may keep to its right."""


class Obstacle(NamedTuple):
    """A round body that a robot must not touch."""

    at: complex
    """Its centre relative to the robot's centre [m; body frame]."""
    radius: float
    """[m]"""
    velocity: complex
    """[m/s; body frame]"""
    first: bool
    """Whether it has right of way."""
    stands: bool = False
    """Whether it will never move: robots go round it and do not wait for it."""
    doubt: float = 0.0
    """Possible error of its direction [rad]; from π on the direction is unknown."""
    age: float = 0.0
    """Age of its data [s]; its motion since then is bounded by its own brake."""
    unsure: float = 0.0
    """Possible distance from `at` by now, to either side [m]."""


class AvoidanceParameters(NamedTuple):
    """How a robot keeps clear of others."""

    radius: float
    """Of its own body [m]."""
    margin: float
    """Room that is left between two bodies [m]."""
    hold: float
    """Longest time that a command may last [s]."""
    blind: float = 0.0
    """Room while the robot does not know its heading [m]: at most the margin."""
    lag: float = 0.0
    """Lag of the robot's speeds behind commands [s]."""


class Moving(NamedTuple):
    """Bounds of a robot's present speed [m/s]."""

    least: float = 0.0
    greatest: float = 0.0


STANDING = Moving()


class HalfPlane(NamedTuple):
    """x v + y w <= most, for the velocity v + i w of a point ahead, at first the front [m/s; body frame]."""

    x: float
    y: float
    most: float


def give_way(
    wanted: Command, obstacles: Sequence[Obstacle], parameters: AvoidanceParameters, limits: Limits
) -> Command:
    """Return the command nearest to `wanted` that respects the right of way.

    Nearest for the control point for moving obstacles, because the law knows best where to wait. Nearest
    for the front for standing ones: a control point further ahead is drawn past the obstacle, and would
    turn the robot back to it for ever.
    """
    bounds = [half_plane(obstacles[k], parameters, limits) for k in range(len(obstacles))]
    lever, scale = front(parameters, limits), limits.offset
    velocity, free = body_velocity(wanted.speed, wanted.turn_rate, lever), True
    for k in range(len(bounds)):
        bound = bounds[k]
        if bound.x * velocity.real + bound.y * velocity.imag > bound.most + BOUND_TOLERANCE:
            free = False
            scale = lever if obstacles[k].stands else scale
    if free:  # the same to the last bit
        return wanted
    bounds = [HalfPlane(bound.x, bound.y * lever / scale, bound.most) for bound in bounds]
    sideways = scale * limits.max_turn_rate
    bounds.append(HalfPlane(1.0, 0.0, limits.max_speed))
    bounds.append(HalfPlane(-1.0, 0.0, limits.max_speed))
    bounds.append(HalfPlane(0.0, 1.0, sideways))
    bounds.append(HalfPlane(0.0, -1.0, sideways))
    velocity = body_velocity(wanted.speed, wanted.turn_rate, scale)
    found, point = nearest(velocity, bounds)
    if not found:  # not all bounds can be met; approaching no obstacle always can
        patient = [HalfPlane(bound.x, bound.y, max(bound.most, 0.0)) for bound in bounds]
        _, point = nearest(velocity, patient)
    return saturate(point, scale, limits.max_speed, limits.max_turn_rate)


def front(parameters: AvoidanceParameters, limits: Limits) -> float:
    """Distance ahead of the centre of the point with the bounded velocity [m]."""
    return min(parameters.radius, limits.offset)


def half_plane(obstacle: Obstacle, parameters: AvoidanceParameters, limits: Limits) -> HalfPlane:
    """Bound how fast the front of the body may approach an obstacle; a disc around it contains the body."""
    lever = front(parameters, limits)
    away = obstacle.at - lever
    distance, towards = abs(away), unit(away)
    room = distance - (lever + parameters.radius + obstacle.radius + obstacle.unsure + parameters.margin)
    most = MAX_APPROACH_RATE * room
    if obstacle.first:
        velocity = obstacle.velocity
        most += towards.real * velocity.real + towards.imag * velocity.imag
    return HalfPlane(towards.real, towards.imag, max(most, -MAX_RETREAT_SHARE * limits.max_speed))


def nearest(wanted: complex, bounds: list[HalfPlane]) -> tuple[bool, complex]:
    """Whether half-planes intersect, and the point of their intersection nearest to `wanted`.

    Unless that is `wanted` it lies on an edge: the nearest point of each line, within the other
    half-planes.
    """
    best, least, within = 0j, math.inf, True
    for i in range(len(bounds)):
        edge = bounds[i]
        squared = edge.x * edge.x + edge.y * edge.y
        beyond = edge.x * wanted.real + edge.y * wanted.imag - edge.most
        if beyond < 0.0 or squared < BOUND_TOLERANCE:
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
            if abs(slope) < BOUND_TOLERANCE:
                high = high if left >= -BOUND_TOLERANCE else -math.inf
            elif slope > 0.0:
                high = min(high, left / slope)
            else:
                low = max(low, left / slope)
        if low > high + BOUND_TOLERANCE:
            continue
        point = foot + max(low, min(high, 0.0)) * along
        distance = abs(point - wanted)
        if distance < least:
            best, least = point, distance
    return within or least < math.inf, wanted if within else best


def brake(
    wanted: Command,
    obstacles: Sequence[Obstacle],
    parameters: AvoidanceParameters,
    moving: Moving = STANDING,
) -> Command:
    """`wanted`, its speed cut so that no obstacle comes nearer by more than half of the room in `hold` [s].

    Of that half a robot that is `moving` keeps the way free that it would still go if it were to stop now:
    its speed times its lag.

    This holds for any duration up to `hold`: the robot turns meanwhile, and the heading nearest to the
    obstacle's direction counts. Standing still, and turning on the spot, are always allowed. Towards an
    obstacle of unknown direction it moves as if that were ahead, without a margin: learning the heading
    needs room.
    """
    low, high = -math.inf, math.inf
    forwards = parameters.lag * max(0.0, moving.greatest)
    backwards = parameters.lag * max(0.0, -moving.least)
    for k in range(len(obstacles)):
        one = obstacles[k]
        distance, blind = abs(one.at), one.doubt >= math.pi
        room = distance - (
            parameters.radius + one.radius + (parameters.blind if blind else parameters.margin)
        )
        half, lasts = 0.5 * room, parameters.hold + AGE_WEIGHT * one.age
        doubt = one.doubt
        if one.unsure > 0.0:
            doubt += math.asin(min(1.0, one.unsure / distance)) if distance > 0.0 else math.pi
        least, greatest = facing(unit(one.at), wanted.turn_rate * (parameters.hold + parameters.lag), doubt)
        if greatest > 0.0:
            high = min(high, max(0.0, (half / greatest - forwards) / lasts))
        if least < 0.0:
            low = max(low, min(0.0, (half / least + backwards) / lasts))
    if low <= wanted.speed <= high:
        return wanted
    return Command(max(low, min(high, wanted.speed)), wanted.turn_rate)


def facing(towards: complex, turn: float, doubt: float) -> tuple[float, float]:
    """Least and greatest cosine between the heading and `towards` while the robot turns by `turn` [rad].

    `doubt` [rad] is the possible error of `towards`, to either side.
    """
    spread = 0.5 * abs(turn) + doubt
    if spread >= math.pi:
        return -1.0, 1.0
    ahead = towards * rotation(-0.5 * turn)
    middle = abs(math.atan2(ahead.imag, ahead.real))
    return math.cos(min(math.pi, middle + spread)), math.cos(max(0.0, middle - spread))


def free_behind(obstacles: Sequence[Obstacle], parameters: AvoidanceParameters, limits: Limits) -> bool:
    """Whether a robot may reverse far: it cannot evade while it does."""
    reach = REVERSING_TIME * limits.max_speed
    for k in range(len(obstacles)):
        one = obstacles[k]
        room = abs(one.at) - parameters.radius - one.radius
        if one.at.real < 0.0 and room < reach:
            return False
    return True


def margin_kept(margin: float, noise: float) -> float:
    """Room to keep between two bodies [m]; `noise` is the standard deviation of a position per axis [m]."""
    return max(margin, PAIR_DEVIATIONS * math.sqrt(2.0) * noise)


def course_gain(travelled: float, gain: float, noise: float) -> float:
    """Gain of the filter's own heading observer after `travelled` [m], from `gain` on [1/m].

    It falls as the robot moves, until `noise` [m] of positions is negligible.
    """
    return max(_least_gain(gain, noise), gain * FADED_GAIN / (FADED_GAIN + gain * travelled))


def heading_doubt(travelled: float, gain: float, noise: float) -> float:
    """Possible error of that observer's heading after this distance [rad].

    |ζ̂ - ζ| <= 2 e^{-∫k} whatever the first guess was, and some k·noise besides, where k is `course_gain`.
    """
    least = _least_gain(gain, noise)
    fading = min(travelled, FADED_GAIN / least - FADED_GAIN / gain)
    kept = (1.0 + gain * fading / FADED_GAIN) ** -FADED_GAIN * math.exp(-least * (travelled - fading))
    wrong, shaken = 2.0 * kept, NOISE_DEVIATIONS * noise * course_gain(travelled, gain, noise)
    return max(MAX_HEADING_ERROR, shaken) + math.asin(wrong) if wrong + shaken < 1.0 else math.pi


def _least_gain(gain: float, noise: float) -> float:
    return gain if noise * gain <= LEARNED_HEADING_DEVIATION else LEARNED_HEADING_DEVIATION / noise


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
    moving: Moving = STANDING,
) -> tuple[Command, Avoidance]:
    """The command for the next `dt` [s] instead of `wanted` (within limits); the same if nothing is near.

    `along` is the velocity of the robots it follows [m/s; body frame]: a robot that only moves along with
    them is blocked, too.
    """
    if len(obstacles) == 0:
        return wanted, Avoidance(0.0, 0.0, before.deadlocks, 0j, 0.0, 0.0)
    want = body_velocity(wanted.speed, wanted.turn_rate, limits.offset)
    near, ahead = _standing(obstacles, parameters, want)
    side = before.side if ahead > MIN_DETOUR_COSINE else 0.0  # once it is behind, the detour ends
    detour = before.detour if side == before.side else 0.0
    before = Avoidance(before.kept, detour, before.deadlocks, before.went, side, before.slow)
    aim = wanted
    if detour > 0.0:
        turned = near * rotation(side * DETOUR_ANGLE) * abs(want) if side != 0.0 else _aside(before) * want
        aim = saturate(turned, limits.offset, limits.max_speed, limits.max_turn_rate)
    done = brake(give_way(aim, obstacles, parameters, limits), obstacles, parameters, moving)
    return done, _updated(want, done, near, along, limits, before, dt)


def _aside(state: Avoidance) -> complex:
    """Rotation of the wanted velocity during a detour [–]."""
    to_the_left = state.deadlocks % LEFT_EVERY == LEFT_EVERY - 1
    return TO_THE_RIGHT.conjugate() if to_the_left else TO_THE_RIGHT


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
    want: complex, done: Command, near: complex, along: complex, limits: Limits, before: Avoidance, dt: float
) -> Avoidance:
    velocity = body_velocity(done.speed, done.turn_rate, limits.offset)
    share = min(1.0, dt / PROGRESS_TIME)
    went = before.went + share * (velocity - before.went)
    slow, wants = 0.0, abs(want - along)
    if wants > MIN_WANTED_SHARE * limits.max_speed:
        slow = limits.max_speed - ((want - along).conjugate() * (velocity - along)).real / wants
    slow = before.slow + min(1.0, dt / LONG_PROGRESS_TIME) * (slow - before.slow)
    detour = max(0.0, before.detour - dt)
    if before.detour > 0.0 and before.side == 0.0:
        return Avoidance(0.0, detour, before.deadlocks, went, 0.0, slow)
    side = before.side if detour > 0.0 else 0.0
    does = abs(went)
    if near != 0j:
        wants = abs(want)
    else:  # it stands, only moves along with others, or goes to and fro
        does = min(abs(velocity), abs(velocity - along))
        if limits.max_speed - slow < MIN_PROGRESS_SHARE * limits.max_speed:
            does = 0.0
    if does >= MAX_BLOCKED_SHARE * limits.max_speed or wants <= MIN_WANTED_SHARE * limits.max_speed:
        return Avoidance(max(0.0, before.kept - dt), detour, before.deadlocks, went, side, slow)
    if before.kept + dt <= DEADLOCK_DELAY:
        return Avoidance(before.kept + dt, detour, before.deadlocks, went, side, slow)
    if near != 0j:
        left = near.real * want.imag - near.imag * want.real >= 0.0
        other = -side if side != 0.0 else (1.0 if left else -1.0)
        return Avoidance(0.0, MAX_DETOUR_TIME, before.deadlocks + 1, went, other, slow)
    return Avoidance(0.0, DETOUR_TIME, before.deadlocks + 1, went, 0.0, slow)
