"""Positions and velocities of the slots, as one agent derives them from the leader's orders.

Each order contains the whole shape at its beat, so all slots that a robot uses are of one order and
consistent. Relayed orders arrive late and unevenly; beats are even: the time between two orders is that of
the beats counted, and the time of a beat is the mean over all orders, however late its own order was. From
that each slot has a velocity, by which it is extrapolated until the next order.

The resulting slot moves no faster than `MAX_SLOT_SPEED_SHARE` of its robot's top speed, whatever an order
says. Every agent limits the slot of one robot alike, so that all of them agree on it all the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from formation.mission.model import Mission
from formation.protocol.order import Order
from formation.slots.shape import PlacedShape

MAX_SLOT_SPEED_SHARE = 0.8
"""Greatest speed of a slot as a share of its robot's speed limit. A leader moves it more slowly."""
VELOCITY_FILTER_TIME = 0.05
"""Time constant of the velocity [s]. Orders are exact; it smooths how even beats are."""
LATENESS_WEIGHT = 0.05
"""Weight of one order's lateness in the mean of all orders."""
MAX_EXTRAPOLATION_TIME = 0.3
"""Longest time that slots move on without an order [s]."""
MAX_BEAT_OFFSET = 1.0
"""Difference from the beats before that shows another clock [s]."""
REST_SPEED = 1e-4
"""Speed below which a slot at its ordered position stands [m/s]."""


@dataclass(slots=True, kw_only=True)
class SlotsState:
    """Where the slots are, by robot, and the beats that move them."""

    at: dict[str, complex]
    """Control point of each, relative to the leader's [m; world frame]."""
    velocity: dict[str, complex]
    """[m/s; world frame]; exactly zero where a slot stands."""
    ordered: dict[str, complex]
    """Where each was at the newest beat [m; world frame]."""
    going: dict[str, complex]
    """How fast each went then [m/s; world frame]."""
    leader_speed: float
    """The leader's top speed: the mission's, or more by the places in the newest orders [m/s]."""
    order: Order | None = None
    """The newest order."""
    beats_began: float = 0.0
    """When beat 0 of this term came, as the mean of all orders [s, monotonic]."""
    moment: float = 0.0
    """Time of the newest step [s, monotonic]."""
    standing: bool = True
    """Whether all slots stand."""


class Slots:
    """The slots of one robot and of all robots that it may measure."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        names = (robot, *spec.neighbours, *spec.fallback_neighbours)
        zero = dict.fromkeys(names, 0j)
        self.state = SlotsState(
            at=zero,
            velocity=zero.copy(),
            ordered=zero.copy(),
            going=zero.copy(),
            leader_speed=mission.leader_speed,
        )
        self._max_speed, self._leader_speed = spec.max_speed, mission.leader_speed
        self._mission = mission
        self._fastest = {name: MAX_SLOT_SPEED_SHARE * mission.robots[name].max_speed for name in names}
        self._period = 1.0 / mission.robots[mission.leader].rate

    def follow(self, order: Order, arrived: float, moment: float) -> None:
        """Move the slots to `moment`, by the newest order and when it arrived [s, monotonic]."""
        state = self.state
        elapsed, state.moment = moment - state.moment, moment
        if state.order is None:
            self._begin(order, arrived)
        elif (order.beat, order.term) != (state.order.beat, state.order.term):
            self._receive(order, state.order, arrived)
        if not state.standing:
            self._go(order, elapsed)

    def _begin(self, order: Order, arrived: float) -> None:
        self.state.order, self.state.beats_began = order, arrived - order.beat * self._period
        placed_shape = PlacedShape.of(order)
        for name in self.state.at:
            self.state.at[name] = self.state.ordered[name] = placed_shape.slot(self._mission, name)

    def _receive(self, order: Order, before: Order, arrived: float) -> None:
        state = self.state
        state.order, same_term = order, order.term == before.term
        late = arrived - order.beat * self._period - state.beats_began
        state.beats_began += late * LATENESS_WEIGHT if same_term and abs(late) < MAX_BEAT_OFFSET else late
        elapsed = (order.beat - before.beat) * self._period if same_term else 0.0
        if elapsed > 0.0:
            self._measure_leader(order, before, elapsed)
        if state.standing and _placed_shape(order) == _placed_shape(before):
            return
        state.standing = False
        share = -math.expm1(-elapsed / VELOCITY_FILTER_TIME)
        placed_shape = PlacedShape.of(order)
        for name, was in state.ordered.items():
            now = placed_shape.slot(self._mission, name)
            state.ordered[name] = now
            if elapsed > 0.0 and abs(now - was) <= self._fastest[name] * elapsed:
                state.going[name] += share * ((now - was) / elapsed - state.going[name])
            elif now != was:  # a jump gives no velocity
                state.going[name] = 0j
            if now == was and abs(state.going[name]) <= REST_SPEED:
                state.going[name] = 0j

    def _measure_leader(self, order: Order, before: Order, elapsed: float) -> None:
        """An order may let the leader drive faster than the mission does."""
        speed = 0.0
        if order.place is not None and before.place is not None:
            moved = complex(order.place.x - before.place.x, order.place.y - before.place.y)
            speed = min(abs(moved) / elapsed, self._max_speed)
        share = -math.expm1(-elapsed / VELOCITY_FILTER_TIME)
        change = share * (speed - self.state.leader_speed)
        self.state.leader_speed = max(self._leader_speed, self.state.leader_speed + change)

    def _go(self, order: Order, elapsed: float) -> None:
        state = self.state
        age = state.moment - (state.beats_began + order.beat * self._period)
        age = min(max(age, -MAX_EXTRAPOLATION_TIME), MAX_EXTRAPOLATION_TIME)
        standing = True
        for name, ordered in state.ordered.items():
            going, most = state.going[name], self._fastest[name] * elapsed
            offset = ordered + going * age - state.at[name]
            far = abs(offset)
            if far <= most:
                state.at[name] = ordered + going * age
            else:
                going = offset * (self._fastest[name] / far)
                state.at[name] += offset * (most / far)
            state.velocity[name] = going
            standing = standing and going == 0j
        state.standing = standing


def _placed_shape(order: Order) -> tuple[object, ...]:
    return order.shape, order.slots, order.rotation, order.scale
