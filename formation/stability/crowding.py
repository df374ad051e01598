"""Whether slots leave room for the margin that the collision filter keeps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from formation.avoidance import LAG, PASSING, RETREAT, Manners, front
from formation.figure import Figure
from formation.mission import Mission
from formation.plane import unit
from formation.stability.spacing import too_close

ROUNDING = 1e-6
"""Slots stand in a mission to so many metres: what misses a bound by less is on it."""


class Room(NamedTuple):
    """The greatest margin for two robots in their slots."""

    margin: float
    """[m]"""
    distance: float
    """Between the slots [m]."""
    shape: str
    first: str
    second: str


def problems(mission: Mission) -> Iterator[str]:
    """Bodies that would be nearer to each other than the margin, of which one minds the other."""
    margin = mission.collisions.margin
    if mission.collisions.mode != "on":
        return
    tight = [room for shape in mission.shapes for room in _tight(mission, shape)]
    if not tight:
        return
    least = min(tight, key=lambda room: round(room.margin, 9))
    others = f" (and {len(tight) - 1} other pair{'' if len(tight) == 2 else 's'})" if len(tight) > 1 else ""
    yield (
        f"collisions.margin = {margin:g} m: too much for the slots of {least.first} and {least.second} "
        f"in {least.shape}{others}, {least.distance:.3g} m apart; must be below {_floored(least.margin):g} m"
    )


def warnings(mission: Mission) -> Iterator[str]:
    """Robots that the filter keeps off their slots: it wants more room than bodies need."""
    if mission.collisions.mode != "on":
        return
    rooms = [room for shape in mission.shapes for room in rooms_of(mission, shape)]
    least = min(rooms, key=lambda room: round(room.margin, 9), default=None)
    if least is None or least.margin >= mission.collisions.margin:
        return
    legal = _floored(least.margin)
    yield (
        f"collisions.margin = {mission.collisions.margin:g} m: the filter keeps {least.first} off its slot "
        f"in {least.shape}, {least.distance:.3g} m from {least.second}'s; "
        + (f"should be at most {legal:g} m" if legal > 0.0 else "slots should be further apart")
    )


def rooms_of(mission: Mission, shape: str) -> Iterator[Room]:
    """Of each robot and whom it minds: the greatest margin at which it may go straight on as its leader does.

    That is `formation.avoidance`: the brake wants room for the time that a command lasts, and the half-plane
    is around the front of the body. Whom no margin would hold back has none.
    """
    figure = Figure.first(mission)._replace(mix=((shape, 1.0),))
    slots = {name: figure.slot(mission, name) / mission.leader_heading for name in mission.followers}
    speed = max(leg.speed for leg in mission.route)
    for name in mission.followers:
        me = mission.robots[name]
        hold = me.longest_command + LAG * mission.collisions.lag
        lever = front(Manners(me.radius, 0.0, hold), me.limits)
        for other in mission.minded(name):
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
            if towards > -RETREAT * me.max_speed:  # or else it leaves faster than anybody has to
                passing = 0.0 if mission.has_right_of_way(other, name) else towards / PASSING
                bounded = abs(away - lever) - lever - radii - passing
            if math.isfinite(least := min(braked, bounded)):
                yield Room(least, abs(slots[other] - slots[name]), shape, name, other)


def _tight(mission: Mission, shape: str) -> Iterator[Room]:
    """Bodies that overlap are a problem of their own."""
    names, margin = mission.followers, mission.collisions.margin
    minded = {name: set(mission.minded(name)) for name in names}
    radii = [mission.robots[name].radius for name in names]
    wide = [radius + 0.5 * (margin + ROUNDING) for radius in radii]
    for i, j, distance in too_close([mission.slot(name, shape) for name in names], wide):
        first, second, room = names[i], names[j], distance - radii[i] - radii[j]
        if room > 0.0 and (first in minded[second] or second in minded[first]):
            yield Room(room, distance, shape, first, second)


def _floored(margin: float) -> float:
    """Rounded down to a tenth of a millimetre, where so much is left."""
    return math.floor((margin + ROUNDING) * 1e4) / 1e4 or margin
