"""What a control law is: one `Controller` value, and the terms that laws share.

Source: Eqs. (7)-(9) of the paper. Each law has a file of its own in `formation.control.laws`. A law with
`Controller.mean` gets means over the neighbours, weighted by `formation.control.trust`, instead of sums.

| symbol | here | meaning | unit |
|---|---|---|---|
| ζ̂ | `heading` | estimated heading, unit length | – |
| Σ_j z_ij^(i) | `relative` | sum of neighbours' control points relative to mine, body frame | m |
| Σ_j z*_ij | `desired` | the same as the formation wants it, world frame | m |
| mean_j v̂_j | `velocity` | mean velocity of the neighbours' control points, world frame | m/s |
| ξ | `integral` | integral of the formation error, world frame | m s |
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from formation.control.observer import Observer
from formation.control.unicycle import Command


class Measured(NamedTuple):
    """A follower's measurements of its neighbours at one moment."""

    relative: complex
    """Σ_j z_ij^(i), or its mean [m; body frame]."""
    desired: complex
    """Σ_j z*_ij, or its mean [m; world frame]."""
    count: Any
    """Number of neighbours in the sums; 1 for means."""
    velocity: complex = 0j
    """mean_j v̂_j [m/s; world frame]; zero switches the feed-forward off."""


class Gains(NamedTuple):
    """Parameters of a law; not every law uses all of them."""

    k_p: float
    """Proportional gain [1/s]."""
    k_i: float
    """Integral gain [1/s²]."""


class Limits(NamedTuple):
    """Limits of the body."""

    offset: float
    """Control-point offset L [m]."""
    max_speed: float
    """u_max [m/s]."""
    max_turn_rate: float
    """ω_max [rad/s]."""
    acceleration: float = math.inf
    """Greatest change of the speed that the ramp allows [m/s²]."""
    reverses: bool = True
    """Whether it may reverse far: not towards obstacles."""


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
    mean: bool = False
    """Whether it takes the weighted mean of its neighbours' errors, with the mission's `gain` as k_P;
    without, it takes their sum."""
    pose_filter: bool = True
    """Whether the pose is filtered (`formation.control.pose_filter`), which replaces the observer."""

    def degree(self, neighbours: int) -> int:
        """Factor of k_P in the loop of a robot with so many neighbours."""
        return 1 if self.mean else neighbours


def error(heading: complex, measured: Measured) -> complex:
    """e = Σ_j (z_ij - z*_ij) [m; world frame], zero in formation."""
    return heading * measured.relative - measured.desired


def nominal(integral: complex, heading: complex, measured: Measured, gains: Gains) -> complex:
    """u_r + i L ω_r [m/s; body frame]: Eq. (7)."""
    to_body = heading.conjugate()
    return gains.k_p * (measured.relative - to_body * measured.desired) + gains.k_i * to_body * integral


MAX_DERIVED_GAIN = 12.0
"""[1/s]"""
LAG_PRODUCT = 0.5
"""Product of gain and lag: the damping ratio of a loop with a first-order lag is then 0.7 [–]."""
SAMPLED_SHARE = 0.25
"""Share of the control period that counts as lag [–]."""
CYCLE_PRODUCT, CYCLE_EXCESS = 12.0, 3
"""Where n robots measure each other in a cycle, k (τ + T) is at most the first over (n + second)²: about a
third of the greatest stable gain of a ring of 2 to 30 robots, the worst graph of its size that was found."""


def fastest_gain(lag: float, period: float, cycle: int, velocity_filter: float) -> float:
    """Gain [1/s] of robots that follow commands with `lag` [s], once in a `period` T [s].

    The delay margin, π/2 of its inverse, is then three periods or more. `cycle` is the number of robots that
    measure each other in a cycle; `velocity_filter` the time constant τ of what they feed forward [s].
    """
    gain = min(MAX_DERIVED_GAIN, LAG_PRODUCT / max(period, lag + SAMPLED_SHARE * period))
    if cycle == 0:
        return gain
    return min(gain, CYCLE_PRODUCT / (float(cycle + CYCLE_EXCESS) ** 2 * (velocity_filter + period)))
