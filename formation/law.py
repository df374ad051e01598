"""The control law: what a follower does about its neighbours.

Source: Eqs. (7)-(9) of the paper. `paper` is the law as printed; `field` is the one robots should drive with.
Both are pure: the integral goes in and comes out.

| symbol | here | meaning | unit |
|---|---|---|---|
| ζ̂ | `heading` | estimated heading, unit length | – |
| Σ_j z_ij^(i) | `relative` | sum of neighbours' control points relative to mine, body frame | m |
| Σ_j z*_ij | `desired` | the same as the formation wants it, world frame | m |
| mean_j v̂_j | `velocity` | mean velocity of the neighbours' control points, world frame | m/s |
| ξ | `integral` | integral of the formation error, world frame | m s |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from formation.unicycle import Command, body_velocity, saturate


class Measured(NamedTuple):
    """What a follower knows of its neighbours at one moment."""

    relative: complex
    """Σ_j z_ij^(i) [m; body frame]."""
    desired: complex
    """Σ_j z*_ij [m; world frame]."""
    count: Any
    """How many neighbours are in the sums."""
    velocity: complex = 0j
    """mean_j v̂_j [m/s; world frame]; zero switches the feed-forward off."""


class Gains(NamedTuple):
    """The law's parameters; the last three belong to the field law alone."""

    k_p: float
    """Proportional gain [1/s]."""
    k_i: float
    """Integral gain [1/s²]."""
    anti_windup: float = 1.0
    """Share of what saturation cut off that is taken back out of the integral [–·s]."""
    integral_band: float = 0.03
    """Mean edge error at which integrating gives way to forgetting [m]."""
    integral_decay: float = 1.0
    """How fast the integral is forgotten far outside the band [1/s]."""


class Limits(NamedTuple):
    """What the body can do."""

    offset: float
    """Control-point offset L [m]."""
    max_speed: float
    """u_max [m/s]."""
    max_turn_rate: float
    """ω_max [rad/s]."""


Law = Callable[[complex, complex, Measured, Gains, Limits, float], tuple[Command, complex]]
"""(integral, heading, measured, gains, limits, dt [s]) -> (command within limits, integral after dt)."""


def error(heading: complex, measured: Measured) -> complex:
    """e = Σ_j (z_ij - z*_ij) [m; world frame], zero in formation."""
    return heading * measured.relative - measured.desired


def nominal(integral: complex, heading: complex, measured: Measured, gains: Gains) -> complex:
    """u_r + i L ω_r [m/s; body frame]: Eq. (7)."""
    to_body = heading.conjugate()
    return gains.k_p * (measured.relative - to_body * measured.desired) + gains.k_i * to_body * integral


def paper(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, dt: float
) -> tuple[Command, complex]:
    """The law as printed, with z_ij read as the displacement of control points: Eqs. (7)-(9)."""
    command = saturate(
        nominal(integral, heading, measured, gains), limits.offset, limits.max_speed, limits.max_turn_rate
    )
    return command, integral + dt * error(heading, measured)


def field(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, dt: float
) -> tuple[Command, complex]:
    """The law for robots: feed-forward, anti-windup and an integral band around Eq. (7); not in the paper.

    The neighbours' velocity does most of what the paper's integral is for. What is left (a wheel slightly
    too large, a velocity slightly misjudged) is small, so integration is only worth having near formation:
    its weight falls smoothly from 1 to 0 around `integral_band`, and where it is 0 the integral is forgotten.
    At zero error the weight is exactly 1, so the equilibrium is the paper's.
    """
    e = error(heading, measured)
    wanted = nominal(integral, heading, measured, gains) + heading.conjugate() * measured.velocity
    command = saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate)
    cut_off = heading * (body_velocity(command.speed, command.turn_rate, limits.offset) - wanted)
    weight = near(abs(e) / measured.count, gains.integral_band)
    growth = weight * (e + gains.anti_windup * cut_off)
    forgotten = min(dt * gains.integral_decay, 1.0)  # not more than there is, however long dt
    return command, integral + dt * growth - (1.0 - weight) * forgotten * integral


def unwound(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits,
    wanted: Command, done: Command, dt: float,
) -> complex:  # fmt: skip
    """The field law's integral after `dt` where `done` took the place of the `wanted` that it had said.

    What is held back after the law counts like what saturation has cut off: they add up.
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


LAWS: Mapping[str, Law] = MappingProxyType({"field": field, "paper": paper})
"""The laws a mission may name."""
