"""The leader's route: straight legs, circles and waypoints, piecewise exact in time.

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
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from formation.arrays import ComplexArray, FloatArray
from formation.legs import Circle, Straight, Waypoints
from formation.mission import Mission
from formation.unicycle import advance


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
    begin: float = 0.0
    """When it is reached [s since the start]."""

    @property
    def end(self) -> tuple[complex, complex]:
        """Position and heading after `duration`, which must be finite."""
        position, heading = advance(self.position, self.heading, self.speed, self.turn_rate, self.duration)
        return complex(position), complex(heading)


class Route:
    """Where the leader is at any time, for one time or an array of times [s since the start]."""

    def __init__(
        self,
        legs: Iterable[Straight | Circle | Waypoints],
        start: complex,
        start_heading: complex = 1.0 + 0.0j,
    ) -> None:
        arcs = tuple(_arcs(legs, start, start_heading))
        self.total: float = math.fsum(arc.duration for arc in arcs)
        """How long the route takes [s]; infinite if its last leg never ends."""
        if math.isfinite(self.total):
            position, heading = arcs[-1].end if arcs else (start, start_heading)
            arcs += (Arc(position, heading, 0.0, 0.0, math.inf),)
        starts = np.cumsum([0.0] + [arc.duration for arc in arcs[:-1]])
        self.arcs = tuple(arc._replace(begin=float(at)) for arc, at in zip(arcs, starts, strict=True))
        """One after the other; the last never ends."""
        self._starts: FloatArray = starts  # [s]; shape (arcs,)
        self._positions: ComplexArray = np.array([arc.position for arc in arcs], dtype=np.complex128)
        self._headings: ComplexArray = np.array([arc.heading for arc in arcs], dtype=np.complex128)
        self._speeds: FloatArray = np.array([arc.speed for arc in arcs])
        self._turn_rates: FloatArray = np.array([arc.turn_rate for arc in arcs])

    @classmethod
    def of(cls, mission: Mission) -> Route:
        """The route of a mission's leader, from the leader's own start."""
        start = mission.robots[mission.leader].start
        return cls(mission.route, start.position, start.heading)

    @property
    def last_change(self) -> float:
        """From when on speed and turn rate stay as they are [s]."""
        return float(self._starts[-1])

    def position(self, time: Any) -> Any:
        """The leader's control point [m; world frame]; complex, or an array of the shape of `time`."""
        arc, elapsed = self._locate(time)
        position, _ = advance(
            self._positions[arc], self._headings[arc], self._speeds[arc], self._turn_rates[arc], elapsed
        )
        return _like(time, position)

    def heading(self, time: Any) -> Any:
        """Direction of travel, unit complex [world frame]; while standing, the last one."""
        arc, elapsed = self._locate(time)
        return _like(time, self._headings[arc] * np.exp(1j * self._turn_rates[arc] * elapsed))

    def velocity(self, time: Any) -> Any:
        """The leader's velocity [m/s; world frame], from the right where a leg begins."""
        arc, _ = self._locate(time)
        moving = np.asarray(time, dtype=np.float64) >= 0.0
        return _like(time, np.where(moving, self._speeds[arc], 0.0) * self.heading(time))

    def turn_rate(self, time: Any) -> Any:
        """How fast the direction of travel turns [rad/s]; float, or an array of the shape of `time`."""
        arc, _ = self._locate(time)
        turn_rate = np.where(np.asarray(time, dtype=np.float64) >= 0.0, self._turn_rates[arc], 0.0)
        return turn_rate if isinstance(time, np.ndarray) else float(turn_rate)

    def _locate(self, time: Any) -> tuple[Any, Any]:
        """Index of the arc at each time, and how long it has lasted by then [s]."""
        since_start = np.maximum(np.asarray(time, dtype=np.float64), 0.0)
        arc = np.searchsorted(self._starts, since_start, side="right") - 1
        return arc, since_start - self._starts[arc]


def _like(time: Any, value: Any) -> Any:
    return value if isinstance(time, np.ndarray) else complex(value)


def _arcs(
    legs: Iterable[Straight | Circle | Waypoints], position: complex, heading: complex
) -> Iterator[Arc]:
    """The legs as arcs, each beginning where the one before ended."""
    for leg in legs:
        for arc in _arcs_of_leg(leg, position, heading):
            yield arc
            if math.isinf(arc.duration):
                return
            position, heading = arc.end


def _arcs_of_leg(leg: Straight | Circle | Waypoints, position: complex, heading: complex) -> Iterator[Arc]:
    if isinstance(leg, (Straight, Circle)):
        if leg.heading_deg is not None:
            heading = cmath.rect(1.0, math.radians(leg.heading_deg))
        turn_rate = 0.0
        if isinstance(leg, Circle):
            turn_rate = leg.speed / leg.radius * (1.0 if leg.turn == "left" else -1.0)
        yield Arc(position, heading, leg.speed, turn_rate, math.inf if leg.duration is None else leg.duration)
        return
    for x, y in leg.waypoints:
        way = complex(x, y) - position
        distance = abs(way)
        if distance > 0.0:  # a waypoint where the leader already is asks for nothing
            yield Arc(position, way / distance, leg.speed, 0.0, distance / leg.speed)
            position = complex(x, y)
