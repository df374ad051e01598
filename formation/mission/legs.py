"""The legs that a leader's route is made of, as a mission file and an operator spell them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from formation.mission.tables import NotNegative, Point, Positive, Table, as_tuple


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
    speed: Positive
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
    speed: Positive
    """Speed of the leader [m/s]."""


def _kind_of_leg(leg: Any) -> str:
    keys = leg if isinstance(leg, dict) else vars(leg)
    return "waypoints" if "waypoints" in keys else "circle" if "radius" in keys else "straight"


Leg = Annotated[
    Annotated[Straight, Tag("straight")]
    | Annotated[Circle, Tag("circle")]
    | Annotated[Waypoints, Tag("waypoints")],
    Discriminator(_kind_of_leg),
]
