"""The geofence: the area of a mission's robots, a rectangle of the world frame.

A mission defines it under ``[bounds]``. Without that it contains every start and every slot along the
first hour of the mission's own route, with a margin of `BOUNDS_MARGIN_SIZES` formation sizes on each side. A
formation's size is the distance of its farthest slot from the leader.

Inside must be each robot's centre (a robot outside holds), and in every order the leader's point and all
slots. Leaders check orders with a `clearance`, agents without, and with a tolerance for the rounding of
slots in orders: so a robot never refuses an order that a leader gives.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, Self

from formation.control.plane import rotation
from formation.control.unicycle import advance
from formation.mission.model import Mission
from formation.mission.route import Arc, Route
from formation.protocol.order import Order
from formation.protocol.reasons import Code, Reason
from formation.slots.shape import PlacedShape
from formation.wire import BadMessage

HORIZON_TIME = 3600.0
"""Part of the mission's route in the default bounds [s], or its `duration` if that is longer."""
BOUNDS_MARGIN_SIZES = 10.0
"""Default margin of the bounds on each side, and greatest distance of a slot from the leader [formation
sizes]."""
MIN_BOUNDS_MARGIN = 10.0
"""Least default margin, however small the formation [m]."""
CLEARANCE = 0.2
"""Distance of slots from the bounds, in addition to the longest control point offset, with which a robot
in its slot stays inside while it settles [m]."""
RETURN_DEPTH = 0.1
"""Depth at which a robot that was outside counts as inside: more than the noise of a position [m]."""
CIRCLE_SAMPLES = 72
"""Number of straight parts by which a circle is approximated."""
CORNER_SAMPLES = 9
"""Number of samples of a shape that turns at a corner."""
MAX_LEG_LENGTH = 4e5
"""Length at which an endless leg is cut: no bounds are larger [m]."""
MAX_CACHED_BOXES = 4
"""Number of shapes with a cached bounding box: an order has two, and most orders have the same."""
LENGTH_TOLERANCE = 1e-9
"""Rounding error that is ignored [m]."""
ROUNDING_TOLERANCE = 1e-4
"""Distance by which slots of an order may be farther from the leader, as they are rounded [m]."""


class Breach(NamedTuple):
    """The point furthest out, or nearest to a limit."""

    excess: float
    """Distance beyond the limit; negative inside [m]."""
    what: str
    axis: str
    """``x``, ``y`` or, from the leader, ``distance``."""
    value: float
    """[m]"""
    limit: float
    """[m]"""

    @property
    def words(self) -> str:
        """``robot4's slot at x = 31.2 m, limit 25 m``."""
        return f"{self.what} at {self.axis} = {self.value:.4g} m, limit {self.limit:.4g} m"


class Exit(NamedTuple):
    """When a route leaves the bounds, and which point leaves them."""

    time: float
    """On the route [s]."""
    breach: Breach
    """Its distance beyond the limit at the end of the leg."""

    @property
    def words(self) -> str:
        """``robot4's slot reaches x = 25 m``."""
        return f"{self.breach.what} reaches {self.breach.axis} = {self.breach.limit:.4g} m"


def size_of(mission: Mission) -> float:
    """Distance of the farthest slot of any shape from the leader [m]."""
    return max(abs(mission.slot(name, shape)) for shape in mission.shapes for name in mission.followers)


class Area(NamedTuple):
    """A rectangle of the world frame [m]."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    reach: float = math.inf
    """Greatest distance of a slot from the leader."""

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """As the mission states it, or its default."""
        if mission.bounds is not None:
            return cls(*mission.bounds.x, *mission.bounds.y)
        size = size_of(mission)
        room = max(BOUNDS_MARGIN_SIZES * size, MIN_BOUNDS_MARGIN)
        starts = [robot.start.position for robot in mission.robots.values()]
        route, until = Route.of(mission), max(HORIZON_TIME, mission.duration)
        places = [look.place for look in _looks(route, 0.0) if look.time < until]
        places.append(route.position(until))
        near, far = cls.around((*starts, *places)), size + room
        return cls(near.x_min - far, near.x_max + far, near.y_min - far, near.y_max + far, max(room, size))

    @classmethod
    def around(cls, points: Sequence[complex]) -> Self:
        """The bounding box of some points, and the greatest of their distances from 0."""
        x, y = [point.real for point in points], [point.imag for point in points]
        return cls(min(x), max(x), min(y), max(y), max(map(abs, points)))

    def contains(self, point: complex, clearance: float = 0.0) -> bool:
        """Whether a point is inside, at least `clearance` from each limit [m]."""
        return (
            self.x_min + clearance <= point.real <= self.x_max - clearance
            and self.y_min + clearance <= point.imag <= self.y_max - clearance
        )

    def breach(self, point: complex, what: str, clearance: float = 0.0) -> Breach:
        """The relation of a point to the limit that it is furthest beyond, or nearest to."""
        return max(self.sides(point, what, clearance))

    def sides(self, point: complex, what: str, clearance: float = 0.0) -> tuple[Breach, ...]:
        """The relation of a point to each of the four limits."""
        x_min, x_max = self.x_min + clearance, self.x_max - clearance
        y_min, y_max = self.y_min + clearance, self.y_max - clearance
        return (
            Breach(point.real - x_max, what, "x", point.real, x_max),
            Breach(x_min - point.real, what, "x", point.real, x_min),
            Breach(point.imag - y_max, what, "y", point.imag, y_max),
            Breach(y_min - point.imag, what, "y", point.imag, y_min),
        )

    @property
    def words(self) -> str:
        """``x -5 … 30 m, y -5 … 5 m``."""
        return f"x {self.x_min:.4g} … {self.x_max:.4g} m, y {self.y_min:.4g} … {self.y_max:.4g} m"


class Geofence:
    """One mission's bounds, and checks against them."""

    def __init__(self, mission: Mission) -> None:
        self.area = Area.of(mission)
        self.clearance = CLEARANCE + max(
            mission.robots[name].control_point_offset for name in mission.followers
        )
        """Distance from the bounds that slots of a leader's orders keep [m]."""
        self._mission, self._size = mission, size_of(mission)
        self._boxes: dict[PlacedShape, Area] = {}  # of the newest shapes

    def __eq__(self, other: object) -> bool:
        """Equal if of the same mission; cached boxes do not matter."""
        if not isinstance(other, Geofence):
            return NotImplemented
        return self._mission == other._mission

    def __hash__(self) -> int:
        return hash(self.area)

    def holds(self, point: complex) -> bool:
        """Whether a point is inside [m; world frame]."""
        return self.area.contains(point)

    def outside(self, centre: complex, *, before: bool) -> Reason | None:
        """How a robot is outside; None inside. If outside `before`: until it is well inside."""
        if self.area.contains(centre, RETURN_DEPTH if before else 0.0):
            return None
        breach = self.area.breach(centre, "", RETURN_DEPTH if self.area.contains(centre) else 0.0)
        return Reason.of(Code.OUTSIDE_BOUNDS, axis=breach.axis, value=breach.value, limit=breach.limit)

    def breach(self, placed_shapes: Iterable[PlacedShape], place: complex, clearance: float = 0.0) -> Breach:
        """The point of the shapes that is furthest out, with the leader at `place` [m; world frame]."""
        worst = self.area.breach(place, "the leader", clearance)
        for placed_shape in placed_shapes:
            for what, slot in self._named(placed_shape):
                worst = max(worst, self.area.breach(place + slot, what, clearance), self._far(slot, what))
        return worst

    def clear_of(self, place: complex, scale: float) -> bool:
        """Whether no shape of this scale comes near the bounds, with the leader at `place`."""
        return self.area.contains(place, self.clearance + scale * self._size)

    def refusal(self, placed_shapes: Sequence[PlacedShape], place: complex) -> str | None:
        """Why shapes cannot be taken in sequence, with the leader at `place`; None if they can.

        The first is the present one: if that is outside already, only moving further out is refused.
        """
        now = self.breach(placed_shapes[:1], place, self.clearance)
        worst = self.breach(placed_shapes, place, self.clearance)
        further = worst.excess > max(now.excess, 0.0) + LENGTH_TOLERANCE
        return f"out of bounds: {worst.words}" if further else None

    def check(self, order: Order) -> None:
        """Raise BadMessage for an order with a slot outside, at present or in its final shape."""
        wanted = PlacedShape(((order.shape, 1.0),), order.rotation, order.scale)
        if self._mission.turning and order.place is not None:
            wanted = wanted._replace(rotation=order.rotation + order.place.heading)
        placed_shapes = (PlacedShape.of(order), wanted)
        place = None if order.place is None else complex(order.place.x, order.place.y)
        if all(self._fits(one, place) for one in placed_shapes):
            return
        if place is None:  # then only the shape's size is known
            worst = max(self._far(slot, what) for one in placed_shapes for what, slot in self._named(one))
        else:
            worst = self.breach(placed_shapes, place)
        raise BadMessage(f"order outside the bounds: {worst.words}")

    def _fits(self, placed_shape: PlacedShape, place: complex | None) -> bool:
        """Whether all of a shape is inside; without a `place`, whether it is not too large."""
        box = self._boxes.get(placed_shape)
        if box is None:
            while len(self._boxes) >= MAX_CACHED_BOXES:
                del self._boxes[next(iter(self._boxes))]
            box = self._boxes[placed_shape] = Area.around(placed_shape.slots(self._mission))
        near = box.reach <= self.area.reach + ROUNDING_TOLERANCE
        if not near or place is None:
            return near
        return (
            self.area.x_min <= place.real + box.x_min
            and place.real + box.x_max <= self.area.x_max
            and self.area.y_min <= place.imag + box.y_min
            and place.imag + box.y_max <= self.area.y_max
        )

    def exit(
        self, route: Route, placed_shape: PlacedShape, since: float = 0.0, heading: complex | None = None
    ) -> Exit | None:
        """When a shape that is led along `route` first leaves the bounds of orders; None for never.

        With ``turning`` its rotation is from the leader's heading, which was `heading` before. Points
        outside may come back: only moving further out counts.
        """
        if self._stays_clear(route, placed_shape.scale):
            return None
        turning, first = self._mission.turning, None
        named = tuple(self._named(placed_shape))
        for begin, end in pairwise(_looks(route, since, heading)):
            if self.clear_of(end.place, placed_shape.scale):
                continue  # all slots are inside: most of a path of hundreds of points
            for what, slot in named:
                after = end.place + (slot * end.heading if turning else slot)
                if self.area.contains(after, self.clearance):
                    continue  # it crosses no limit outwards
                before = begin.place + (slot * begin.heading if turning else slot)
                for at, breach in self._crossed(before, after, what):
                    time = begin.time + at * (end.time - begin.time)
                    if first is None or time < first.time:
                        first = Exit(time, breach)
            if first is not None:
                return first
        return None

    def _stays_clear(self, route: Route, scale: float) -> bool:
        """Whether a route of straight legs keeps shapes of this scale off the bounds, however they turn.

        True for most paths of hundreds of points: the leader sends no position while it looks at each.
        """
        return all(
            arc.turn_rate == 0.0
            and (arc.speed == 0.0 or math.isfinite(arc.duration))
            and self.clear_of(arc.position, scale)
            for arc in route.arcs
        )

    def _crossed(self, before: complex, after: complex, what: str) -> Iterator[tuple[float, Breach]]:
        """Each limit that a straight path crosses outwards, and the share of the path at which it does."""
        sides = (self.area.sides(point, what, self.clearance) for point in (before, after))
        for was, becomes in zip(*sides, strict=True):
            if becomes.excess > max(was.excess, 0.0) + LENGTH_TOLERANCE:
                yield max(-was.excess, 0.0) / (becomes.excess - min(was.excess, 0.0)), becomes

    def _far(self, slot: complex, what: str) -> Breach:
        far = abs(slot)
        return Breach(far - self.area.reach, what, "distance", far, self.area.reach)

    def _named(self, placed_shape: PlacedShape) -> Iterator[tuple[str, complex]]:
        for name, slot in zip(self._mission.names, placed_shape.slots(self._mission), strict=True):
            yield "the leader" if name == self._mission.leader else f"{name}'s slot", slot


class _Look(NamedTuple):
    """The leader's pose at a moment of its route."""

    time: float
    """[s]"""
    place: complex
    """[m; world frame]"""
    heading: complex
    """Unit complex [world frame]."""


def _looks(route: Route, since: float, heading: complex | None = None) -> Iterator[_Look]:
    """Moments of a route from `since` on between which the leader moves straight, or nearly so."""
    for begin, arc in zip(route.begins, route.arcs, strict=True):
        if begin + arc.duration <= since:
            continue
        looks = tuple(_arc_looks(arc, begin, max(since - begin, 0.0)))
        if heading is not None and looks[0].heading != heading:
            turn = cmath.phase(looks[0].heading / heading)
            for part in range(CORNER_SAMPLES):
                yield looks[0]._replace(heading=heading * rotation(turn * part / CORNER_SAMPLES))
        yield from looks
        heading = looks[-1].heading


def _arc_looks(arc: Arc, begin: float, since: float) -> Iterator[_Look]:
    end, parts = arc.duration, 1
    if arc.speed == 0.0:
        end = since
    elif arc.turn_rate == 0.0:
        end = min(end, since + MAX_LEG_LENGTH / arc.speed)
    else:
        circle = math.tau / abs(arc.turn_rate)
        end = min(end, since + circle)
        parts = max(1, math.ceil((end - since) / circle * CIRCLE_SAMPLES))
    for part in range(parts + 1):
        time = since + (end - since) * part / parts
        yield _Look(begin + time, *advance(arc.position, arc.heading, arc.speed, arc.turn_rate, time))
