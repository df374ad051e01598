"""The geofence: where a mission's robots may be, a rectangle of the world frame.

A mission states it under ``[bounds]``. Without that it holds every start and every slot along the first hour
of the mission's own route, with `ROOM` formation sizes to spare on each side. A formation's size is the
distance of its farthest slot from the leader.

What has to be inside: each robot's centre (a robot outside holds), and in every order the leader's point and
all slots. Orders are judged with a `clearance`, agents judge them without: an order that a leader gives is
thus never refused by a robot.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, Self

from formation.figure import Figure
from formation.mission import Mission
from formation.order import Order
from formation.plane import rotation
from formation.route import Arc, Route
from formation.unicycle import advance
from formation.wire import BadMessage

HORIZON = 3600.0
"""By default the bounds hold so much of the mission's route [s], or its `duration` if that is longer."""
ROOM = 10.0
"""By default the bounds leave so many formation sizes on each side, and a slot is no further from the
leader than so many."""
LEAST_ROOM = 10.0
"""At least so much, however small the formation [m]."""
CLEARANCE = 0.2
"""Slots keep so far from the bounds, beyond the longest control point offset, that a robot in its slot stays
inside while it settles [m]."""
RETURN_DEPTH = 0.1
"""A robot that was outside counts as inside from so deep on: more than the noise of a position [m]."""
CIRCLE_SAMPLES = 72
"""A circle is looked at in so many straight parts."""
CORNER_SAMPLES = 9
"""A figure that turns at a corner is looked at so often."""
FARTHEST = 4e5
"""A leg without an end is looked at so far: no bounds are larger [m]."""
BOXES = 4
"""Of so many figures it is kept what holds them: an order has two, and most orders have the same."""
GRAIN = 1e-9
"""What is less is rounding [m]."""


class Breach(NamedTuple):
    """What is furthest out, or nearest to a limit."""

    excess: float
    """How far beyond the limit it is; negative inside [m]."""
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
    """When a route leaves the bounds, and what leaves them."""

    time: float
    """On the route [s]."""
    breach: Breach
    """How far out that is by the end of the leg."""

    @property
    def words(self) -> str:
        """``robot4's slot reaches x = 25 m``."""
        return f"{self.breach.what} reaches {self.breach.axis} = {self.breach.limit:.4g} m"


def size_of(mission: Mission) -> float:
    """How far the farthest slot of any shape is from the leader [m]."""
    return max(abs(mission.slot(name, shape)) for shape in mission.shapes for name in mission.followers)


class Area(NamedTuple):
    """A rectangle of the world frame [m]."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    reach: float = math.inf
    """No slot may be further from the leader."""

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """As the mission states it, or its default."""
        if mission.bounds is not None:
            return cls(*mission.bounds.x, *mission.bounds.y)
        size = size_of(mission)
        room = max(ROOM * size, LEAST_ROOM)
        starts = [robot.start.position for robot in mission.robots.values()]
        route, until = Route.of(mission), max(HORIZON, mission.duration)
        places = [look.place for look in _looks(route, 0.0) if look.time < until]
        places.append(route.position(until))
        near, far = (*starts, *places), size + room
        return cls(
            min(point.real for point in near) - far,
            max(point.real for point in near) + far,
            min(point.imag for point in near) - far,
            max(point.imag for point in near) + far,
            max(room, size),
        )

    def breach(self, point: complex, what: str, clearance: float = 0.0) -> Breach:
        """How a point stands to the limit that it is furthest beyond, or nearest to."""
        return max(self.sides(point, what, clearance))

    def sides(self, point: complex, what: str, clearance: float = 0.0) -> tuple[Breach, ...]:
        """How a point stands to each of the four limits."""
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
    """One mission's bounds, and what leaves them."""

    def __init__(self, mission: Mission) -> None:
        self.area = Area.of(mission)
        self.clearance = CLEARANCE + max(
            mission.robots[name].control_point_offset for name in mission.followers
        )
        """Slots of an order that a leader gives keep so far from the bounds [m]."""
        self._mission, self._size = mission, size_of(mission)
        self._boxes: dict[Figure, _Box] = {}  # of the newest figures

    def __eq__(self, other: object) -> bool:
        """Of the same mission; what is kept of figures makes no difference."""
        if not isinstance(other, Geofence):
            return NotImplemented
        return self._mission == other._mission

    def __hash__(self) -> int:
        return hash(self.area)

    def holds(self, point: complex) -> bool:
        """Whether a point is inside [m; world frame]."""
        return self.area.breach(point, "").excess <= 0.0

    def outside(self, centre: complex, *, before: bool) -> str | None:
        """How a robot is outside, in words; None inside. Outside `before`: until it is well inside."""
        breach = self.area.breach(centre, "")
        if breach.excess <= 0.0 and before:
            breach = self.area.breach(centre, "", RETURN_DEPTH)
        if breach.excess <= 0.0:
            return None
        return f"{breach.axis} = {breach.value:.2f} m, limit {breach.limit:.2f} m"

    def breach(self, figures: Iterable[Figure], place: complex, clearance: float = 0.0) -> Breach:
        """What of the figures is furthest out, the leader being at `place` [m; world frame]."""
        worst = self.area.breach(place, "the leader", clearance)
        for figure in figures:
            for what, slot in self._named(figure):
                worst = max(worst, self.area.breach(place + slot, what, clearance), self._far(slot, what))
        return worst

    def clear_of(self, place: complex, scale: float) -> bool:
        """Whether no figure of this scale comes near the bounds, the leader being at `place`."""
        return self.area.breach(place, "", self.clearance + scale * self._size).excess <= 0.0

    def refusal(self, figures: Sequence[Figure], place: complex) -> str | None:
        """Why figures cannot be taken one after the other, the leader being at `place`; None if they can.

        The first is the present one: where that is out already, only going further out is refused.
        """
        now = self.breach(figures[:1], place, self.clearance)
        worst = self.breach(figures, place, self.clearance)
        return None if worst.excess <= max(now.excess, 0.0) + GRAIN else f"out of bounds: {worst.words}"

    def check(self, order: Order) -> None:
        """Raise BadMessage for an order with a slot outside, as it is now or as it is to become."""
        wanted = Figure(((order.shape, 1.0),), order.rotation, order.scale)
        if self._mission.turning and order.place is not None:
            wanted = wanted._replace(rotation=order.rotation + order.place.heading)
        figures = (Figure.of(order), wanted)
        place = None if order.place is None else complex(order.place.x, order.place.y)
        if all(self._fits(one, place) for one in figures):
            return
        if place is None:  # it says only how large the figure is
            worst = max(self._far(slot, what) for one in figures for what, slot in self._named(one))
        else:
            worst = self.breach(figures, place)
        raise BadMessage(f"order outside the bounds: {worst.words}")

    def _fits(self, figure: Figure, place: complex | None) -> bool:
        """Whether all of a figure is inside; without a `place`, whether it is not too large."""
        box = self._boxes.get(figure)
        if box is None:
            while len(self._boxes) >= BOXES:
                del self._boxes[next(iter(self._boxes))]
            box = self._boxes[figure] = _Box.of(figure.slots(self._mission))
        if box.farthest > self.area.reach or place is None:
            return box.farthest <= self.area.reach
        return (
            self.area.x_min <= place.real + box.x_min
            and place.real + box.x_max <= self.area.x_max
            and self.area.y_min <= place.imag + box.y_min
            and place.imag + box.y_max <= self.area.y_max
        )

    def exit(
        self, route: Route, figure: Figure, since: float = 0.0, heading: complex | None = None
    ) -> Exit | None:
        """When a figure that is led along `route` first leaves what orders are judged by; None for never.

        With ``turning`` its rotation is from the leader's heading, which was `heading` before. What is out
        already may come back: only going further out counts.
        """
        turning, first = self._mission.turning, None
        for begin, end in pairwise(_looks(route, since, heading)):
            for what, slot in self._named(figure):
                before = begin.place + (slot * begin.heading if turning else slot)
                after = end.place + (slot * end.heading if turning else slot)
                for at, breach in self._crossed(before, after, what):
                    time = begin.time + at * (end.time - begin.time)
                    if first is None or time < first.time:
                        first = Exit(time, breach)
            if first is not None:
                return first
        return None

    def _crossed(self, before: complex, after: complex, what: str) -> Iterator[tuple[float, Breach]]:
        """Each limit that is crossed outwards on a straight path, and at which part of it."""
        sides = zip(
            self.area.sides(before, what, self.clearance),
            self.area.sides(after, what, self.clearance),
            strict=True,
        )
        for was, becomes in sides:
            if becomes.excess > max(was.excess, 0.0) + GRAIN:
                yield max(-was.excess, 0.0) / (becomes.excess - min(was.excess, 0.0)), becomes

    def _far(self, slot: complex, what: str) -> Breach:
        far = abs(slot)
        return Breach(far - self.area.reach, what, "distance", far, self.area.reach)

    def _named(self, figure: Figure) -> Iterator[tuple[str, complex]]:
        for name, slot in zip(self._mission.names, figure.slots(self._mission), strict=True):
            yield "the leader" if name == self._mission.leader else f"{name}'s slot", slot


class _Box(NamedTuple):
    """What holds a figure, from the leader [m]."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    farthest: float

    @classmethod
    def of(cls, slots: Sequence[complex]) -> Self:
        x, y = [slot.real for slot in slots], [slot.imag for slot in slots]
        return cls(min(x), max(x), min(y), max(y), max(map(abs, slots)))


class _Look(NamedTuple):
    """Where the leader is at a moment of its route."""

    time: float
    """[s]"""
    place: complex
    """[m; world frame]"""
    heading: complex
    """Unit complex [world frame]."""


def _looks(route: Route, since: float, heading: complex | None = None) -> Iterator[_Look]:
    """Moments of a route from `since` on between which the leader goes straight, or nearly so."""
    for begin, arc in zip(route.begins, route.arcs, strict=True):
        if begin + arc.duration <= since:
            continue
        for look in _arc_looks(arc, begin, max(since - begin, 0.0)):
            if heading is not None and look.heading != heading:
                yield from _corner(look, heading)
            yield look
            heading = look.heading


def _arc_looks(arc: Arc, begin: float, since: float) -> Iterator[_Look]:
    end, parts = arc.duration, 1
    if arc.speed == 0.0:
        end = since
    elif arc.turn_rate == 0.0:
        end = min(end, since + FARTHEST / arc.speed)
    else:
        circle = math.tau / abs(arc.turn_rate)
        end = min(end, since + circle)
        parts = max(1, math.ceil((end - since) / circle * CIRCLE_SAMPLES))
    for part in range(parts + 1):
        time = since + (end - since) * part / parts
        yield _Look(begin + time, *advance(arc.position, arc.heading, arc.speed, arc.turn_rate, time))


def _corner(look: _Look, heading: complex) -> Iterator[_Look]:
    turn = cmath.phase(look.heading / heading)
    for part in range(CORNER_SAMPLES):
        yield look._replace(heading=heading * rotation(turn * part / CORNER_SAMPLES))
