"""The robot: a unicycle, its control point, its limits.

Source: section 2.1 of the paper. Assumes rolling without slip.

| symbol | here | meaning | unit |
|---|---|---|---|
| p | `position` | centre (axle midpoint), world frame | m |
| ζ | `heading` | unit complex, world frame | – |
| u, ω | `speed`, `turn_rate` | forward speed, turn rate | m/s, rad/s |
| L | `offset` | control point ahead of the axle | m |
| h | `control_point` | p + L ζ, what the formation is made of | m |
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from formation.plane import Reals, Vectors, clip, rotation


class Command(NamedTuple):
    """What a robot is told to do; scalars or arrays of one shape."""

    speed: Any
    """Forward speed u [m/s; body frame]."""
    turn_rate: Any
    """Turn rate ω [rad/s], counter-clockwise positive."""


def advance(
    position: Vectors, heading: Vectors, speed: Reals, turn_rate: Reals, dt: float
) -> tuple[Vectors, Vectors]:
    """Pose after `dt` [s] at constant speed and turn rate: Eq. (1), solved exactly along the arc."""
    half = rotation(turn_rate * (0.5 * dt))
    chord = speed * dt * np.sinc(turn_rate * (dt / (2.0 * np.pi)))
    return position + chord * half * heading, heading * half * half


def control_point(position: Vectors, heading: Vectors, offset: Reals) -> Vectors:
    """h = p + L ζ [m; world frame]."""
    point: Vectors = position + offset * heading
    return point


def body_velocity(speed: Reals, turn_rate: Reals, offset: Reals) -> Any:
    """Velocity of the control point in the robot's own frame, u + i L ω [m/s]: Eq. (5)."""
    return speed + 1j * (offset * turn_rate)


def control_point_velocity(heading: Vectors, speed: Reals, turn_rate: Reals, offset: Reals) -> Vectors:
    """Velocity of the control point [m/s; world frame]: Eq. (4)."""
    velocity: Vectors = heading * body_velocity(speed, turn_rate, offset)
    return velocity


def saturate(nominal: Vectors, offset: Reals, max_speed: Reals, max_turn_rate: Reals) -> Command:
    """The nominal control-point velocity u_r + i L ω_r as a command within limits: Eqs. (8), (9).

    Multiplying by s = min(1, limit/|value|) is the same as clipping to the limit, without dividing by a
    value that may be zero. Saturation acts on each body axis by itself.
    """
    return Command(clip(nominal.real, max_speed), clip(nominal.imag / offset, max_turn_rate))
