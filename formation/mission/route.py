"""The leader's route: straight legs, circles and waypoints, piecewise exact in time.

Its legs are models, as a mission file and an operator spell them.

The leader is a point that goes along its route (section 2.2 of the paper: piecewise constant velocity;
circles and waypoints are not in the paper). Its control point is its position. Before the start and after
the end it stands still.

| symbol | here | meaning | unit |
|---|---|---|---|
| h_1 | `position` | the leader's control point, world frame | m |
| v_c | `velocity` | its velocity, world frame | m/s |
| ζ_1 | `heading` | direction of travel, unit complex, world frame | – |
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import accumulate
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Discriminator, Field, Tag

from formation.control.plane import rotation
from formation.control.unicycle import advance
from formation.mission.tables import NotNegative, Point, Positive, Table, as_tuple

if TYPE_CHECKING:
    from formation.mission.model import Mission


MIN_LEG_LENGTH = 1e-6
"""Distance up to which a waypoint counts as reached [m]: the direction to a nearer one is rounding error."""
MovingSpeed = Annotated[float, Field(ge=1e-6, le=1e9)]
"""[m/s]; slower legs take longer than a float can tell."""


class Straight(Table):
    """A leg of constant velocity."""

    speed: NotNegative
    """Speed of the leader [m/s]."""
    heading_deg: float
    """Direction of travel, counter-clockwise from x [°; world frame]."""
    duration: Positive | None = None
    """How long the leg takes; without this key it never ends [s]."""


class Circle(Table):
    """A leg along a circle, to the left or to the right."""

    radius: Annotated[float, Field(ge=0.001, le=1e6)]
    """Radius of the circle [m]."""
    speed: MovingSpeed
    """Speed of the leader [m/s]."""
    heading_deg: float | None = None
    """Direction of travel at the start of the leg; by default that at the end of the leg before, and the
    leader's start heading for the first leg [°; world frame]."""
    turn: Literal["left", "right"] = "left"
    """Side to which the leader turns."""
    duration: Positive | None = None
    """How long the leg takes; without this key it never ends [s]."""


class Waypoints(Table):
    """Straight legs from where the leader is through each point."""

    waypoints: Annotated[tuple[Point, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """x, y of each point [m; world frame]."""
    speed: MovingSpeed
    """Speed of the leader [m/s]."""


def _kind_of_leg(leg: Any) -> str | None:
    if not isinstance(leg, (dict, Straight, Circle, Waypoints)):
        return None
    keys = leg if isinstance(leg, dict) else vars(leg)
    return "waypoints" if "waypoints" in keys else "circle" if "radius" in keys else "straight"


Leg = Annotated[
    Annotated[Straight, Tag("straight")]
    | Annotated[Circle, Tag("circle")]
    | Annotated[Waypoints, Tag("waypoints")],
    Discriminator(
        _kind_of_leg,
        custom_error_type="leg",
        custom_error_message="Input should be a leg: a table of speed and heading_deg, radius or waypoints",
    ),
]


class Arc(NamedTuple):
    """A stretch of constant speed and turn rate; a straight one has turn rate 0."""

    position: complex
    """Where it starts [m; world frame]."""
    heading: complex
    """Direction of travel at its start, unit complex [world frame]."""
    speed: float
    """[m/s]"""
    turn_rate: float
    """[rad/s], counter-clockwise positive."""
    duration: float
    """[s]; infinite for a leg that never ends."""

    @property
    def end(self) -> tuple[complex, complex]:
        """Position and heading after `duration`, which must be finite."""
        return advance(self.position, self.heading, self.speed, self.turn_rate, self.duration)


class Route:
    """Where the leader is at any time [s since the start]."""

    def __init__(self, legs: Iterable[Leg], start: complex, start_heading: complex = 1.0 + 0.0j) -> None:
        arcs = tuple(_arcs(legs, start, start_heading))
        self.total: float = math.fsum(arc.duration for arc in arcs)
        """How long the route takes [s]; infinite if its last leg never ends."""
        if math.isfinite(self.total):
            position, heading = arcs[-1].end if arcs else (start, start_heading)
            arcs += (Arc(position, heading, 0.0, 0.0, math.inf),)
        self.arcs = arcs
        """One after the other; the last never ends."""
        self.begins = tuple(accumulate((arc.duration for arc in arcs[:-1]), initial=0.0))
        """When each of them is reached [s]."""

    @classmethod
    def of(cls, mission: Mission) -> Route:
        """The route of a mission's leader, from the leader's own start."""
        start = mission.robots[mission.leader].start
        return cls(mission.route, start.position, start.heading)

    @property
    def last_change(self) -> float:
        """From when on speed and turn rate stay as they are [s]."""
        return self.begins[-1]

    def next_change(self, time: float) -> float:
        """When its speed or its direction next changes at once after `time` [s]; infinite if it does not."""
        place = bisect_right(self.begins, max(time, 0.0))
        return self.begins[place] if place < len(self.begins) else math.inf

    def position(self, time: float) -> complex:
        """The leader's control point [m; world frame]."""
        arc, elapsed = self._locate(time)
        position, _ = advance(arc.position, arc.heading, arc.speed, arc.turn_rate, elapsed)
        return position

    def heading(self, time: float) -> complex:
        """Direction of travel, unit complex [world frame]; while standing, the last one."""
        arc, elapsed = self._locate(time)
        return arc.heading * rotation(arc.turn_rate * elapsed)

    def velocity(self, time: float) -> complex:
        """The leader's velocity [m/s; world frame], from the right where a leg begins."""
        arc, _ = self._locate(time)
        return arc.speed * self.heading(time) if time >= 0.0 else 0j

    def turn_rate(self, time: float) -> float:
        """How fast the direction of travel turns [rad/s]."""
        arc, _ = self._locate(time)
        return arc.turn_rate if time >= 0.0 else 0.0

    def _locate(self, time: float) -> tuple[Arc, float]:
        """The arc at a time, and how long it has lasted by then [s]."""
        since_start = max(time, 0.0)
        place = bisect_right(self.begins, since_start) - 1
        return self.arcs[place], since_start - self.begins[place]


def _arcs(legs: Iterable[Leg], position: complex, heading: complex) -> Iterator[Arc]:
    """The legs as arcs, each beginning where the one before ended."""
    for leg in legs:
        for arc in _arcs_of_leg(leg, position, heading):
            yield arc
            if math.isinf(arc.duration):
                return
            position, heading = arc.end


def _arcs_of_leg(leg: Leg, position: complex, heading: complex) -> Iterator[Arc]:
    if isinstance(leg, (Straight, Circle)):
        if leg.heading_deg is not None:
            heading = cmath.rect(1.0, math.radians(leg.heading_deg))
        turn_rate = 0.0
        if isinstance(leg, Circle):
            turn_rate = leg.speed / leg.radius * (1.0 if leg.turn == "left" else -1.0)
        yield Arc(position, heading, leg.speed, turn_rate, math.inf if leg.duration is None else leg.duration)
        return
    for x, y in leg.waypoints:
        step = complex(x, y) - position
        distance = abs(step)
        if distance > MIN_LEG_LENGTH:  # a waypoint where the leader already is asks for nothing
            yield Arc(position, step / distance, leg.speed, 0.0, distance / leg.speed)
            position = complex(x, y)
