"""The robot: a unicycle, its control point, its limits.

Source: section 2.1 of the paper. Assumes rolling without slip.

| symbol | here | meaning | unit |
|---|---|---|---|
| p | `position` | centre (axle midpoint), world frame | m |
| ζ | `heading` | unit complex, world frame | – |
| u, ω | `speed`, `turn_rate` | forward speed, turn rate | m/s, rad/s |
| L | `offset` | control point ahead of the axle | m |
| h | `control_point` | p + L ζ, the point that keeps formation | m |
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.control.plane import clip, rotation


class Command(NamedTuple):
    """A robot's command."""

    speed: float
    """Forward speed u [m/s; body frame]."""
    turn_rate: float
    """Turn rate ω [rad/s], counter-clockwise positive."""


AT_REST = Command(0.0, 0.0)


def advance(
    position: complex, heading: complex, speed: float, turn_rate: float, dt: float
) -> tuple[complex, complex]:
    """Pose after `dt` [s] at constant speed and turn rate: Eq. (1), solved exactly along the arc."""
    return along(position, heading, speed * dt, turn_rate * dt)


def along(position: complex, heading: complex, distance: float, turn: float) -> tuple[complex, complex]:
    """Pose at the end of an arc of signed length `distance` [m] that turns by `turn` [rad]."""
    lean = 0.5 * turn
    half = rotation(lean)
    chord = distance * half.imag / lean if lean != 0.0 else distance  # sin(x)/x of the arc's length
    return position + chord * half * heading, heading * half * half


def driven(moving: Command, command: Command, lag: float, dt: float) -> tuple[Command, Command]:
    """`dt` [s] of wheels that lag: mean speed and turn rate over it, and those at its end.

    They follow `command` with a first-order `lag` [s], starting from `moving`. Exact for a constant command.
    """
    if lag <= 0.0:
        return command, command
    share = -math.expm1(-dt / lag)
    mean = share * lag / dt
    speed, turn_rate = moving.speed - command.speed, moving.turn_rate - command.turn_rate
    return (
        Command(command.speed + mean * speed, command.turn_rate + mean * turn_rate),
        Command(moving.speed - share * speed, moving.turn_rate - share * turn_rate),
    )


def control_point(position: complex, heading: complex, offset: float) -> complex:
    """h = p + L ζ [m; world frame]."""
    return position + offset * heading


def body_velocity(speed: float, turn_rate: float, offset: float) -> complex:
    """Velocity of the control point in the robot's own frame, u + i L ω [m/s]: Eq. (5)."""
    return complex(speed, offset * turn_rate)


def saturate(nominal: complex, offset: float, max_speed: float, max_turn_rate: float) -> Command:
    """The nominal control-point velocity u_r + i L ω_r as a command within limits: Eqs. (8), (9).

    Multiplying by s = min(1, limit/|value|) is the same as clipping to the limit, without dividing by a
    value that may be zero. Saturation acts on each body axis by itself.
    """
    return Command(clip(nominal.real, max_speed), clip(nominal.imag / offset, max_turn_rate))
