"""A placed shape: the position of every slot at one moment, while shapes are mixed, turned and scaled.

The leader moves its shape smoothly and each order contains its present state, so a robot that has just
started, or has missed a second of it, needs only the newest order.

    slot_i = scale · e^{i rotation} · Σ_shape share_shape · drawn_i        [m; world frame, from the leader]
"""

from __future__ import annotations

import cmath
from collections.abc import Collection
from typing import NamedTuple, Self

from formation.mission.model import Mission
from formation.protocol.order import Order
from formation.wire import BadMessage

SHARE_TOLERANCE = 1e-6
"""Tolerance of the sum of the shares of shapes, which is 1."""


class PlacedShape(NamedTuple):
    """A mix of a mission's shapes, turned and scaled."""

    mix: tuple[tuple[str, float], ...]
    """Shapes and their shares, which sum to 1."""
    rotation: float = 0.0
    """Counter-clockwise [rad; world frame]."""
    scale: float = 1.0

    @classmethod
    def of(cls, order: Order) -> Self:
        """Return the placed shape of `order`."""
        if order.slots is None:
            return cls(((order.shape, 1.0),), order.rotation, order.scale)
        return cls(tuple(order.slots.mix.items()), order.slots.rotation, order.slots.scale)

    @classmethod
    def first(cls, mission: Mission) -> Self:
        """Return the initial placed shape of a mission."""
        rotation = cmath.phase(mission.leader_heading) if mission.turning else 0.0
        return cls(((mission.first_shape, 1.0),), rotation)

    def slot(self, mission: Mission, robot: str) -> complex:
        """Control point of `robot` relative to the leader's [m; world frame]."""
        drawn = sum((share * mission.slot(robot, shape) for shape, share in self.mix), 0j)
        return self.scale * cmath.rect(1.0, self.rotation) * drawn

    def slots(self, mission: Mission) -> list[complex]:
        """All of them over ``mission.names``, the leader's (0) first [m; world frame]."""
        return [self.slot(mission, name) for name in mission.names]


def check_shape(order: Order, shapes: Collection[str]) -> None:
    """Raise BadMessage for an order that these shapes cannot form."""
    known = ", ".join(shapes)
    if order.shape not in shapes:
        raise BadMessage(f"unknown shape {order.shape!r}; known: {known}")
    if order.slots is None:
        return
    if unknown := sorted(name for name in order.slots.mix if name not in shapes):
        raise BadMessage(f"slots of unknown shape {unknown[0]!r}; known: {known}")
    whole = sum(order.slots.mix.values())
    if abs(whole - 1.0) > SHARE_TOLERANCE:
        raise BadMessage(f"slots with shares that sum to {whole:g}; must be 1")
