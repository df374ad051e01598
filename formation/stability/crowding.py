"""Check the room that the collision filter keeps between bodies: slots, starts, and paths that could meet."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

from formation.control.avoidance import (
    AGE_WEIGHT,
    HEADING_GAIN_RATIO,
    MAX_APPROACH_RATE,
    MAX_RETREAT_SHARE,
    AvoidanceParameters,
    front,
    heading_doubt,
)
from formation.control.plane import unit
from formation.mission.model import Mission
from formation.mission.rules import too_close
from formation.sensing.scan import MIN_RADIUS_LIMIT
from formation.slots.shape import PlacedShape

BOUND_TOLERANCE = 1e-6
"""Tolerance of bounds [m], as a mission gives slots with few digits."""
DISTANCE_STEP = 0.001
"""Step of the search for a travelled distance [m]."""


class Room(NamedTuple):
    """The greatest margin for two robots in their slots."""

    margin: float
    """[m]"""
    distance: float
    """Between the slots [m]."""
    shape: str
    first: str
    second: str


class Gap(NamedTuple):
    """The free space between two slots for a third robot."""

    needed: float
    """Least distance between the slots [m]."""
    distance: float
    """[m]"""
    shape: str
    first: str
    second: str


class Segment(NamedTuple):
    """A straight path, relative to the leader [m]."""

    begin: complex
    end: complex


def problems(mission: Mission) -> Iterator[str]:
    """Bodies that would be nearer to each other than the margin, of which one avoids the other."""
    if mission.collisions.mode != "on":
        return
    tight = [room for shape in mission.shapes for room in _tight(mission, shape)]
    if not tight:
        return
    least = min(tight, key=lambda room: round(room.margin, 9))
    yield (
        f"{_named(mission)}: too much for the slots of {least.first} and {least.second} in "
        f"{least.shape}{_others(tight)}, {least.distance:.3g} m apart; "
        f"must be below {_floored(least.margin):g} m"
    )


def warnings(mission: Mission) -> Iterator[str]:
    """Robots that the filter keeps off their slots, because it needs more room than bodies do."""
    if mission.collisions.mode != "on":
        return
    rooms = [room for shape in mission.shapes for room in rooms_of(mission, shape)]
    least = min(rooms, key=lambda room: round(room.margin, 9), default=None)
    if least is None or least.margin >= mission.collisions.room:
        return
    legal = _floored(least.margin)
    yield (
        f"{_named(mission)}: the filter keeps {least.first} off its slot "
        f"in {least.shape}, {least.distance:.3g} m from {least.second}'s, "
        f"behind a leader at {max(leg.speed for leg in mission.route):.3g} m/s; "
        + (
            f"should be at most {legal:g} m"
            if legal > 0.0
            else "place slots further apart, or slow the leader"
        )
    )


def rooms_of(mission: Mission, shape: str) -> Iterator[Room]:
    """For each robot and each that it avoids: the greatest margin at which it may move as its leader does.

    These are the limits of `formation.control.avoidance`: the brake needs room for the time that a command
    lasts, and the half-plane is around the front of the body. Pairs that no margin limits are omitted.
    """
    placed_shape = PlacedShape.first(mission)._replace(mix=((shape, 1.0),))
    slots = {name: placed_shape.slot(mission, name) / mission.leader_heading for name in mission.followers}
    speed = max(leg.speed for leg in mission.route)
    for name in mission.followers:
        me = mission.robots[name]
        hold = me.longest_command + mission.collisions.lag
        if me.measurement != "local":
            hold += AGE_WEIGHT * mission.collisions.delay
        lever = front(AvoidanceParameters(me.radius, 0.0, hold), me.limits)
        for other in mission.avoided_by(name):
            spec, away = mission.robots[other], slots[other] - slots[name] + me.control_point_offset
            radii = me.radius + spec.radius
            if me.measurement == "local":  # a sensor sees control points, and bodies anywhere around these
                radii += spec.control_point_offset
            else:
                away -= spec.control_point_offset
            ahead, towards = speed * unit(away).real, speed * unit(away - lever).real
            braked = bounded = math.inf
            if ahead > 0.0:
                braked = abs(away) - radii - 2.0 * hold * ahead
            # otherwise it leaves faster than any robot has to
            if towards > -MAX_RETREAT_SHARE * me.max_speed:
                passing = 0.0 if mission.has_right_of_way(other, name) else towards / MAX_APPROACH_RATE
                bounded = abs(away - lever) - lever - radii - passing
            if math.isfinite(least := min(braked, bounded)):
                yield Room(least, abs(slots[other] - slots[name]), shape, name, other)


def rows(mission: Mission) -> Iterator[str]:
    """Warn of rows of slots that no robot can pass: one that came behind them would never reach its slot."""
    if mission.collisions.mode != "on":
        return
    gaps = [gap for shape in mission.shapes for gap in _narrow(mission, shape)]
    if not gaps:
        return
    widest = max(gaps, key=lambda gap: gap.needed)
    yield (
        f"slots of {widest.first} and {widest.second} in {widest.shape}{_others(gaps)} are "
        f"{widest.distance:.3g} m apart: no robot can pass between them, and one that was left behind may "
        f"follow such a row without reaching its slot; slots should be at least {widest.needed:.3g} m apart"
    )


def _narrow(mission: Mission, shape: str) -> Iterator[Gap]:
    """Pairs of slots between which the filter lets no robot pass that avoids both.

    Neighbours are avoided at their positions, others as the robot's scanner sees them. A disc around the
    front of its body contains the body, and keeps the margin on both sides.
    """
    names = mission.followers
    avoided = {name: set(mission.avoided_by(name)) for name in names}
    radii = [mission.robots[name].radius for name in names]
    most = max(_width(mission, name, seen) for name in names for seen in ((), names))
    wide = [radius + 0.5 * most for radius in radii]
    # sorted: the first of equal gaps is named
    for i, j, distance in sorted(too_close([mission.slot(name, shape) for name in names], wide)):
        pair = {names[i], names[j]}
        between = [
            _width(mission, name, () if pair <= avoided[name] else pair) for name in names if name not in pair
        ]
        widest = max(between, default=0.0)
        needed = radii[i] + radii[j] + widest
        if widest > 0.0 and distance < needed - BOUND_TOLERANCE:
            yield Gap(needed, distance, shape, names[i], names[j])


def _width(mission: Mission, name: str, seen: Collection[str]) -> float:
    """Free space that a robot needs between two bodies that it avoids [m].

    With `seen` it avoids them as its scanner sees robots with these names; 0 if it has no scanner.
    """
    me = mission.robots[name]
    margin = mission.collisions.room
    if seen:
        if me.scanner == "none":
            return 0.0
        overhang = max(mission.robots[one].overhang for one in seen)
        margin = max(margin, me.margin + overhang) + MIN_RADIUS_LIMIT  # circles around hits bulge
    return 2.0 * (front(AvoidanceParameters(me.radius, 0.0, 0.0), me.limits) + me.radius + margin)


def _tight(mission: Mission, shape: str) -> Iterator[Room]:
    """The room of each pair nearer than the margin; bodies that overlap are reported separately."""
    names, margin = mission.followers, mission.collisions.room
    avoided = {name: set(mission.avoided_by(name)) for name in names}
    radii = [mission.robots[name].radius for name in names]
    wide = [radius + 0.5 * (margin + BOUND_TOLERANCE) for radius in radii]
    for i, j, distance in too_close([mission.slot(name, shape) for name in names], wide):
        first, second, room = names[i], names[j], distance - radii[i] - radii[j]
        if room > 0.0 and (first in avoided[second] or second in avoided[first]):
            yield Room(room, distance, shape, first, second)


def _named(mission: Mission) -> str:
    """The required room, and the keys of the mission that determine it."""
    rules = mission.collisions
    if rules.room > rules.margin:
        return f"collisions.noise = {rules.noise:g} m, which takes a margin of {rules.room:.3g} m"
    return f"collisions.margin = {rules.margin:g} m"


def _others(pairs: Sequence[object]) -> str:
    """How many pairs there are besides the named one."""
    more = len(pairs) - 1
    return f" (and {more} other pair{'' if more == 1 else 's'})" if more else ""


def _floored(margin: float) -> float:
    """Round down to a tenth of a millimetre, unless that gives zero."""
    return math.floor((margin + BOUND_TOLERANCE) * 1e4) / 1e4 or margin


def starts(mission: Mission) -> Iterator[str]:
    """Starts too near to each other for robots to learn their headings under the filter."""
    if mission.collisions.mode != "on":
        return
    tight = []
    for name in mission.followers:
        me = mission.robots[name]
        if me.heading == "measured" or me.measurement == "local":
            continue
        sharper = HEADING_GAIN_RATIO if me.localisation == "odometry" else 1.0
        learning = _learning_distance(sharper * mission.law.observer_gain, mission.collisions.noise)
        needed = mission.collisions.blind + 2.0 * learning
        for other in mission.avoided_by(name):
            spec = mission.robots[other]
            gap = abs(spec.start.position - me.start.position) - me.radius - spec.radius
            if gap < needed - BOUND_TOLERANCE and (gap, needed, other, name) not in tight:
                tight.append((gap, needed, name, other))
    if not tight:
        return
    gap, needed, first, second = min(tight)
    yield (
        f"{first} and {second}{_others(tight)} start with {max(gap, 0.0):.3g} m between their bodies: with "
        f"collisions.noise = {mission.collisions.noise:g} m they need {needed:.2g} m to learn their headings "
        "without touching, and may hold each other up; start them further apart"
    )


def _learning_distance(gain: float, noise: float) -> float:
    """Distance after which a robot knows on which side of it another robot is [m]."""
    distance = 0.0
    while heading_doubt(distance, gain, noise) >= 0.5 * math.pi:
        distance += DISTANCE_STEP
    return distance


def unfiltered(mission: Mission) -> Iterator[str]:
    """Warning of `formation check` about a law without collision filter."""
    if mission.collisions.mode != "off" and len(mission.followers) > 1:
        yield f"the {mission.law.kind} law has no collision filter: robots do not avoid each other"


def unavoided(mission: Mission) -> tuple[tuple[str, str], ...]:
    """Pairs of followers that could meet, and do not both avoid each other.

    They go straight from their starts to their first slots, at any times: where these paths come nearer to
    each other than bodies and control points need, the robots could meet. Between shapes they move
    together, and an order is refused if slots would touch during the transition.
    """
    if mission.collisions.mode == "off":
        return ()
    avoided = {name: set(mission.avoided_by(name)) for name in mission.followers}
    segments = {name: _segment(mission, name) for name in mission.followers}
    return tuple(
        (one, other)
        for one, other in combinations(mission.followers, 2)
        if not (one in avoided[other] and other in avoided[one])
        and between(segments[one], segments[other]) < _needed(mission, one, other)
    )


def could_meet(mission: Mission) -> Iterator[str]:
    """Warnings of `formation check` about these pairs."""
    pairs = unavoided(mission)
    if not pairs:
        return
    first, second = pairs[0]
    yield (
        f"{first} and {second}{_others(pairs)} could meet on their paths, and do not both avoid each other: "
        'name them in each other\'s `avoid`, or say avoid = "all" under [robot]'
    )


def between(one: Segment, other: Segment) -> float:
    """Least distance between two straight paths [m]."""
    if _apart(one, other) and _apart(other, one):
        return 0.0
    ends = ((one.begin, other), (one.end, other), (other.begin, one), (other.end, one))
    return min(_to(point, segment) for point, segment in ends)


def _segment(mission: Mission, name: str) -> Segment:
    leader = mission.robots[mission.leader].start.position
    turned = mission.leader_heading if mission.turning else 1.0
    return Segment(mission.robots[name].start.position - leader, mission.slot(name) * turned)


def _needed(mission: Mission, one: str, other: str) -> float:
    bodies = (mission.robots[one], mission.robots[other])
    return sum(body.radius + body.control_point_offset for body in bodies) + mission.collisions.margin


def _apart(line: Segment, segment: Segment) -> bool:
    along = (line.end - line.begin).conjugate()
    return (along * (segment.begin - line.begin)).imag * (along * (segment.end - line.begin)).imag < 0.0


def _to(point: complex, segment: Segment) -> float:
    along = segment.end - segment.begin
    squared = abs(along) ** 2
    share = 0.0 if squared == 0.0 else (along.conjugate() * (point - segment.begin)).real / squared
    return abs(segment.begin + max(0.0, min(1.0, share)) * along - point)
