"""The legs that a leader's route is made of, as a mission file and an operator spell them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from formation.tables import NotNegative, Point, Positive, Table, as_tuple


class Straight(Table):
    """A leg of constant velocity; without a duration it goes on for ever."""

    speed: NotNegative
    heading_deg: float
    duration: Positive | None = None


class Circle(Table):
    """A leg along a circle that starts in the direction of travel and turns left or right."""

    radius: Annotated[float, Field(ge=0.001, le=1e6)]
    speed: Positive
    heading_deg: float | None = None
    """Direction at the start; by default as the leg before ended, else 0."""
    turn: Literal["left", "right"] = "left"
    duration: Positive | None = None


class Waypoints(Table):
    """Legs of constant speed through points of the world frame, the first from wherever the leader is."""

    waypoints: Annotated[tuple[Point, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    speed: Positive


def _kind_of_leg(leg: Any) -> str:
    keys = leg if isinstance(leg, dict) else vars(leg)
    return "waypoints" if "waypoints" in keys else "circle" if "radius" in keys else "straight"


Leg = Annotated[
    Annotated[Straight, Tag("straight")]
    | Annotated[Circle, Tag("circle")]
    | Annotated[Waypoints, Tag("waypoints")],
    Discriminator(_kind_of_leg),
]
