"""The leader's orders: the newest one, the shape at each moment, and the leader since when. No clock.

An order is attached to the leader's position, so it counts from the moment of that position on. Between two
orders the shape is interpolated linearly.
"""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache, partial
from typing import NamedTuple

from formation.mission.model import Mission
from formation.protocol.election import check_term, rank_of
from formation.protocol.order import Order, newer
from formation.slots.shape import PlacedShape
from formation.wire import BadMessage, Now

ORDERED_TOLERANCE = 1e-6
"""Tolerance of a share, a scale or a rotation [rad] that counts as the wanted one."""
MAX_HEADING_LAG = 0.1
"""Largest lag of a shape that turns with its leader and counts as arrived [rad]."""
MAX_CACHED_SLOTS = 8
"""Number of shapes with cached slots."""


class OrderedMotion(NamedTuple):
    """The shape, rotation, scale and route that are wanted. With another it has to settle again."""

    shape: str
    rotation: float
    """[rad]"""
    scale: float
    route: str

    @classmethod
    def of(cls, order: Order) -> OrderedMotion:
        """Return what `order` wants."""
        return cls(order.shape, order.rotation, order.scale, order.route)


class Lead(NamedTuple):
    """The leader, since when, and the leader before it."""

    name: str
    term: int
    since: float
    """[s, our system clock]"""
    before: str
    """The leader before; empty for the first one."""
    silent: float
    """Time without a leader before that [s]."""


class Orders:
    """Orders received with the leader's positions."""

    def __init__(self, mission: Mission, size: int) -> None:
        """`size` is the number of shapes kept, equal to that of the leader's positions."""
        self.newest: Order | None = None
        self.lead: Lead | None = None
        self.formed_since = -math.inf
        """Since when the shape is the wanted one [s, our system clock]; infinite before."""
        self._mission = mission
        self._first = PlacedShape.first(mission)
        self._placed_shapes: deque[tuple[float, PlacedShape]] = deque(maxlen=size)
        self._draw = lru_cache(MAX_CACHED_SLOTS)(partial(_slots, mission))
        self._received = -math.inf  # when the leader's position last arrived [s, monotonic]

    @property
    def placed_shape(self) -> PlacedShape:
        """The shape of the newest order."""
        return PlacedShape.of(self.newest) if self.newest else self._first

    @property
    def formed(self) -> bool:
        """Whether the shape has reached the newest order."""
        return self.formed_since < math.inf

    def admit(self, order: Order, arrived: float, wall: float) -> bool:
        """Return whether it begins a new term; times as in `process_order`. Raises BadMessage if refused."""
        shapes = self._mission.shapes
        if order.shape not in shapes or (order.slots and not order.slots.mix.keys() <= shapes.keys()):
            raise BadMessage("unknown shape")
        check_term(order.term, Now(arrived, wall))
        if self.newest is None or order.term == self.newest.term:
            return False
        if order.term < self.newest.term:
            raise BadMessage("of an earlier term: another leads by now")
        return True

    def process_order(self, order: Order, moment: float, arrived: float, wall: float) -> bool:
        """Take an admitted order of `moment` [s, our system clock]; return whether it wants something new.

        It arrived at `arrived` [s, monotonic], that is `wall` [s, our system clock].
        """
        before = self.newest
        if self.lead is None or order.term != self.lead.term:
            leader = leader_of(self._mission, order.term)
            former = self.lead.name if self.lead else ""
            self.lead = Lead(leader, order.term, wall, former, arrived - self._received if self.lead else 0.0)
        self._received = arrived
        if not newer(order, before):
            return False
        self.newest = order
        self._placed_shapes.append((moment, PlacedShape.of(order)))
        another = before is not None and OrderedMotion.of(before) != OrderedMotion.of(order)
        there = _there(order, self._mission)
        if another or (before is None and not there):
            self.formed_since = math.inf
        if there and not self.formed:
            self.formed_since = moment
        return another

    def forget(self) -> None:
        """Forget all moments after our system clock was set."""
        self._placed_shapes.clear()
        self.formed_since = -math.inf if self.formed else math.inf

    def slots(self, moment: float) -> dict[str, complex]:
        """Return all slots at `moment` [s, our system clock], relative to the leader [m; world frame]."""
        before = after = math.inf, self.placed_shape
        for before in reversed(self._placed_shapes):
            if before[0] <= moment:
                break
            after = before
        here, there = self._draw(before[1]), self._draw(after[1])
        if before[1] == after[1]:
            return here
        share = (moment - before[0]) / (after[0] - before[0])
        return {name: slot + share * (there[name] - slot) for name, slot in here.items()}


def _slots(mission: Mission, placed_shape: PlacedShape) -> dict[str, complex]:
    return dict(zip(mission.names, placed_shape.slots(mission), strict=True))


def _there(order: Order, mission: Mission) -> bool:
    """Return whether the shape is the wanted one."""
    if order.slots is None:
        return True
    if order.slots.mix.get(order.shape, 0.0) < 1.0 - ORDERED_TOLERANCE:
        return False
    if abs(order.slots.scale - order.scale) > ORDERED_TOLERANCE:
        return False
    ahead = order.place.heading if mission.turning and order.place else 0.0
    behind = math.remainder(order.slots.rotation - order.rotation - ahead, math.tau)
    return abs(behind) <= (MAX_HEADING_LAG if mission.turning else ORDERED_TOLERANCE)


def leader_of(mission: Mission, term: int) -> str:
    """Return the name of the candidate that leads in `term`; empty if the mission has none."""
    if not mission.standbys:
        return mission.leader
    rank = rank_of(term)
    return mission.candidates[rank] if rank < len(mission.candidates) else ""
