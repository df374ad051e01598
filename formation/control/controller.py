"""What a control law is: one `Controller` value, and the terms that laws share.

Source: Eqs. (7)-(9) of the paper. Each law has a file of its own in `formation.control.laws`.

| symbol | here | meaning | unit |
|---|---|---|---|
| ζ̂ | `heading` | estimated heading, unit length | – |
| Σ_j z_ij^(i) | `relative` | sum of neighbours' control points relative to mine, body frame | m |
| Σ_j z*_ij | `desired` | the same as the formation wants it, world frame | m |
| mean_j v̂_j | `velocity` | mean velocity of the neighbours' control points, world frame | m/s |
| ξ | `integral` | integral of the formation error, world frame | m s |
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from formation.control.observer import Observer
from formation.control.unicycle import Command, body_velocity


class Measured(NamedTuple):
    """A follower's measurements of its neighbours at one moment."""

    relative: complex
    """Σ_j z_ij^(i) [m; body frame]."""
    desired: complex
    """Σ_j z*_ij [m; world frame]."""
    count: Any
    """Number of neighbours in the sums."""
    velocity: complex = 0j
    """mean_j v̂_j [m/s; world frame]; zero switches the feed-forward off."""


class Gains(NamedTuple):
    """Parameters of a law; not every law uses all of them."""

    k_p: float
    """Proportional gain [1/s]."""
    k_i: float
    """Integral gain [1/s²]."""
    anti_windup: float = 1.0
    """Share of the part cut off by saturation that is subtracted from the integral [–·s]."""
    integral_band: float = 0.03
    """Mean edge error at which the integral changes from integrating to decaying [m]."""
    integral_decay: float = 1.0
    """Rate at which the integral decays far outside the band [1/s]."""


class Limits(NamedTuple):
    """Limits of the body."""

    offset: float
    """Control-point offset L [m]."""
    max_speed: float
    """u_max [m/s]."""
    max_turn_rate: float
    """ω_max [rad/s]."""


Step = Callable[[complex, complex, Measured, Gains, Limits, float], tuple[Command, complex]]
"""(integral, heading, measured, gains, limits, dt [s]) -> (command within limits, integral after dt)."""


class Controller(NamedTuple):
    """A control law, and what it needs around it."""

    name: str
    """Name in missions and ``--law``."""
    step: Step
    observer: Observer
    """Estimates the heading."""
    integral: bool = True
    """Whether it integrates the formation error; without, k_I counts as 0."""
    feed_forward: bool = True
    """Whether it takes the neighbours' mean velocity; without, `Measured.velocity` is 0."""
    delay_compensation: bool = True
    """Whether neighbours' positions are extrapolated to the present by their velocity."""
    collision_filter: bool = True
    ramp: bool = True
    """Whether its commands ramp (`formation.control.ramp`)."""


def error(heading: complex, measured: Measured) -> complex:
    """e = Σ_j (z_ij - z*_ij) [m; world frame], zero in formation."""
    return heading * measured.relative - measured.desired


def nominal(integral: complex, heading: complex, measured: Measured, gains: Gains) -> complex:
    """u_r + i L ω_r [m/s; body frame]: Eq. (7)."""
    to_body = heading.conjugate()
    return gains.k_p * (measured.relative - to_body * measured.desired) + gains.k_i * to_body * integral


def unwound(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits,
    wanted: Command, done: Command, dt: float,
) -> complex:  # fmt: skip
    """Integral after `dt` [s] if `done` replaces the `wanted` command of the law.

    What the collision filter cuts off counts like what saturation cuts off: they add up.
    """
    if wanted == done:
        return integral
    speed, turn_rate = done.speed - wanted.speed, done.turn_rate - wanted.turn_rate
    cut_off = heading * body_velocity(speed, turn_rate, limits.offset)
    weight = near(abs(error(heading, measured)) / measured.count, gains.integral_band)
    return integral + dt * weight * gains.anti_windup * cut_off


def near(distance: float, band: float) -> float:
    """1 at zero, 1/2 at `band`, falling as the fourth power beyond; flat at zero, so noise cannot chatter."""
    ratio = distance / band
    squared = ratio * ratio
    return 1.0 / (1.0 + squared * squared)
