"""What the tables of a mission file are made of: names, numbers with bounds, and what every table refuses."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

NAME, TITLE = r"^[a-z][a-z0-9_]*$", r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
Name = Annotated[str, StringConstraints(pattern=NAME, max_length=64)]
Title = Annotated[str, StringConstraints(pattern=TITLE, max_length=64)]
Positive = Annotated[float, Field(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e9)]
Speed = Annotated[float, Field(gt=0.0, le=1e3)]
"""[m/s] or [rad/s], as far as a message may carry it."""
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]

Namespace = Annotated[str, StringConstraints(max_length=128)]
"""ROS namespace without its leading slash; which spellings are legal is one of the rules."""
"""How ROS 2 reaches Zenoh: through zenoh-bridge-ros2dds, or natively by rmw_zenoh."""


def as_tuple(value: Any) -> Any:
    """A list as TOML has it, as a tuple; all else as it is."""
    return tuple(value) if isinstance(value, list) else value


Point = Annotated[tuple[Metres, Metres], BeforeValidator(as_tuple)]
"""x, y [m]."""


class Table(BaseModel):
    """A table of the mission file: frozen, unknown keys refused, nothing coerced, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
