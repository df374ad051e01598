"""What whoever leads wants: the newest order, the figure at each moment, and who leads since when. No clock.

An order rides on the leader's position, so it counts from the moment of that position on. Between two of
them the figure is as far between as the moment is.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import NamedTuple

from formation.election import check_term
from formation.figure import Figure
from formation.mission import Mission
from formation.order import Order, newer
from formation.wire import BadMessage, Now
from monitor.figures.terms import leader_of

EXACT = 1e-6
"""By so little a share, a scale or a rotation [rad] may differ and still be the one that is wanted."""
ALONG = 0.1
"""By so little a figure that turns with its leader may be behind it and still count as there [rad]."""
REDRAWN = 8
"""So many figures are drawn only once."""


class Wish(NamedTuple):
    """What is asked of the formation. With another one it has to settle anew."""

    shape: str
    rotation: float
    """[rad]"""
    scale: float
    route: str

    @classmethod
    def of(cls, order: Order) -> Wish:
        """What `order` asks for."""
        return cls(order.shape, order.rotation, order.scale, order.route)


class Lead(NamedTuple):
    """Who leads, since when, and who did before."""

    name: str
    term: int
    since: float
    """[s, our system clock]"""
    before: str = ""
    """Who led before; empty for the first that was heard."""
    silent: float = 0.0
    """How long nobody had led by then [s]."""


class Orders:
    """Orders as they come with the leader's positions."""

    def __init__(self, mission: Mission, size: int) -> None:
        """`size` is how many figures are kept: as many as the leader's positions are."""
        self.newest: Order | None = None
        self.lead: Lead | None = None
        self.formed_since = -math.inf
        """From when on the figure has been where it is wanted [s, our system clock]; infinite before."""
        self._mission = mission
        self._first = Figure.first(mission)
        self._figures: deque[tuple[float, Figure]] = deque(maxlen=size)
        self._drawn: dict[Figure, dict[str, complex]] = {}  # the newest few
        self._heard = -math.inf  # whoever leads, when last [s, monotonic]

    @property
    def figure(self) -> Figure:
        """Where the slots are by the newest order."""
        return Figure.of(self.newest) if self.newest else self._first

    @property
    def formed(self) -> bool:
        """Whether the figure has been where it is wanted since that was wished."""
        return self.formed_since < math.inf

    def admit(self, order: Order, arrived: float, wall: float) -> bool:
        """Whether it begins a new term; times as in `take`. Raises BadMessage if it counts for nothing."""
        shapes = self._mission.shapes
        if order.shape not in shapes or (order.slots and not order.slots.mix.keys() <= shapes.keys()):
            raise BadMessage("unknown shape")
        check_term(order.term, Now(arrived, wall))
        if self.newest is None or order.term == self.newest.term:
            return False
        if order.term < self.newest.term:
            raise BadMessage("of an earlier term: another leads by now")
        return True

    def take(self, order: Order, moment: float, arrived: float, wall: float) -> bool:
        """Take one that was admitted, of `moment` [s, our system clock]; whether it is another wish.

        It arrived at `arrived` [s, monotonic], that is `wall` [s, our system clock].
        """
        before = self.newest
        if self.lead is None or order.term != self.lead.term:
            who = leader_of(self._mission, order.term)
            former = self.lead.name if self.lead else ""
            self.lead = Lead(who, order.term, wall, former, arrived - self._heard if self.lead else 0.0)
        self._heard = arrived
        if not newer(order, before):
            return False
        self.newest = order
        self._figures.append((moment, Figure.of(order)))
        another = before is not None and Wish.of(before) != Wish.of(order)
        there = _there(order, self._mission)
        if another or (before is None and not there):
            self.formed_since = math.inf
        if there and not self.formed:
            self.formed_since = moment
        return another

    def forget(self) -> None:
        """Our system clock was set, by which moments are told."""
        self._figures.clear()
        self.formed_since = -math.inf if self.formed else math.inf

    def slots(self, moment: float) -> dict[str, complex]:
        """Where everybody belongs at `moment` [s, our system clock], from the leader [m; world frame]."""
        before, after = self._around(moment)
        here = self._draw(before[1])
        if before[1] == after[1]:
            return here
        share, there = (moment - before[0]) / (after[0] - before[0]), self._draw(after[1])
        return {name: slot + share * (there[name] - slot) for name, slot in here.items()}

    def _around(self, moment: float) -> tuple[tuple[float, Figure], tuple[float, Figure]]:
        """The figures before and after; the same twice where there is none on one side."""
        if not self._figures:
            only = moment, self.figure
            return only, only
        if moment >= self._figures[-1][0]:
            return self._figures[-1], self._figures[-1]
        for after, before in pairwise(reversed(self._figures)):
            if before[0] <= moment:
                return before, after
        return self._figures[0], self._figures[0]

    def _draw(self, figure: Figure) -> dict[str, complex]:
        """Its slots by name."""
        if figure not in self._drawn:
            if len(self._drawn) >= REDRAWN:
                self._drawn.pop(next(iter(self._drawn)))
            self._drawn[figure] = dict(zip(self._mission.names, figure.slots(self._mission), strict=True))
        return self._drawn[figure]


def _there(order: Order, mission: Mission) -> bool:
    """Whether the figure is where it is wanted."""
    if order.slots is None:
        return True
    if order.slots.mix.get(order.shape, 0.0) < 1.0 - EXACT:
        return False
    if abs(order.slots.scale - order.scale) > EXACT:
        return False
    ahead = order.place.heading if mission.turning and order.place else 0.0
    behind = math.remainder(order.slots.rotation - order.rotation - ahead, math.tau)
    return abs(behind) <= (ALONG if mission.turning else EXACT)
