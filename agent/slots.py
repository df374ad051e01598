"""Where the slots are, as one agent takes them from the leader's orders, and how fast they go.

Each order says where the whole figure was at its beat, so all slots that a robot goes by are of one order and
fit each other. Orders come relayed, late and unevenly; beats are even: between two orders as much time went
by as beats were counted, and a beat came as much before another as all of them do on the mean, however late
its own order was. From that each slot has a velocity, by which it is carried on until the next order.

What is taken from there moves no faster than `SHARE` of its robot's top speed, whatever an order says. Every
agent limits the slot of one robot alike, so that all of them agree on it all the time.
"""

from __future__ import annotations

import math

from formation.figure import Figure
from formation.mission import Mission
from formation.order import Order

SHARE = 0.8
"""Of a robot's speed limit: so fast its slot is moved at most. A leader moves it more slowly than that."""
FILTER = 0.05
"""Time constant of the velocity [s]. Orders are exact; what is smoothed out is how even beats are."""
EVEN = 0.05
"""So much of an order's lateness is taken for that of all orders."""
LONGEST = 0.3
"""For so long slots go on without an order [s]."""
OUT_OF_STEP = 1.0
"""Beats so far off the ones before are counted by another clock [s]."""
AT_REST = 1e-4
"""A slot that is no faster than this, and where it is ordered to be, stands [m/s]."""


class Slots:
    """The slots of one robot and of all whom it may measure."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        names = (robot, *spec.neighbours, *spec.fallback_neighbours)
        self.at = dict.fromkeys(names, 0j)
        """Control point of each, relative to the leader's [m; world frame]."""
        self.velocity = dict.fromkeys(names, 0j)
        """[m/s; world frame]; exactly zero where a slot stands."""
        self._mission = mission
        self._fastest = {name: SHARE * mission.robots[name].max_speed for name in names}
        self._period = 1.0 / mission.robots[mission.leader].rate
        self._order: Order | None = None
        self._ordered = dict.fromkeys(names, 0j)  # where each was at the newest beat,
        self._going = dict.fromkeys(names, 0j)  # and how fast it went
        self._beats_began = 0.0  # when beat 0 of this term came, as the mean of all orders has it
        self._moment = 0.0  # of the newest step [s, monotonic]
        self._standing = True

    def follow(self, order: Order, arrived: float, moment: float) -> None:
        """Move the slots to `moment`, by the newest order and when it arrived [s, monotonic]."""
        elapsed, self._moment = moment - self._moment, moment
        if self._order is None:
            self._begin(order, arrived)
        elif (order.beat, order.term) != (self._order.beat, self._order.term):
            self._hear(order, self._order, arrived)
        if not self._standing:
            self._go(order, elapsed)

    def _begin(self, order: Order, arrived: float) -> None:
        self._order, self._beats_began = order, arrived - order.beat * self._period
        figure = Figure.of(order)
        for name in self.at:
            self.at[name] = self._ordered[name] = figure.slot(self._mission, name)

    def _hear(self, order: Order, before: Order, arrived: float) -> None:
        self._order, same_term = order, order.term == before.term
        late = arrived - order.beat * self._period - self._beats_began
        self._beats_began += late * EVEN if same_term and abs(late) < OUT_OF_STEP else late
        if self._standing and _figure(order) == _figure(before):
            return
        self._standing = False
        elapsed = (order.beat - before.beat) * self._period if same_term else 0.0
        share = -math.expm1(-elapsed / FILTER)
        figure = Figure.of(order)
        for name, was in self._ordered.items():
            now = figure.slot(self._mission, name)
            self._ordered[name] = now
            if elapsed > 0.0 and abs(now - was) <= self._fastest[name] * elapsed:
                self._going[name] += share * ((now - was) / elapsed - self._going[name])
            elif now != was:  # a jump says nothing of how the slot goes on
                self._going[name] = 0j
            if now == was and abs(self._going[name]) <= AT_REST:
                self._going[name] = 0j

    def _go(self, order: Order, elapsed: float) -> None:
        age = self._moment - (self._beats_began + order.beat * self._period)
        age = min(max(age, -LONGEST), LONGEST)
        standing = True
        for name, ordered in self._ordered.items():
            going, most = self._going[name], self._fastest[name] * elapsed
            way = ordered + going * age - self.at[name]
            far = abs(way)
            if far <= most:
                self.at[name] = ordered + going * age
            else:
                going = way * (self._fastest[name] / far)
                self.at[name] += way * (most / far)
            self.velocity[name] = going
            standing = standing and going == 0j
        self._standing = standing


def _figure(order: Order) -> tuple[object, ...]:
    return order.shape, order.slots, order.rotation, order.scale
