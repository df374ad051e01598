"""How much a neighbour counts: little while it is faster than the leader ever is; not in the paper.

A neighbour that catches up is neither where the formation wants it nor as fast. Its own speed shows that,
and nothing else need be communicated. Its position says little along its motion, and more across it. All
weights are equal in formation, so the equilibrium, and the linear loop around it, are those of the plain
mean.

| symbol | here | meaning | unit |
|---|---|---|---|
| w | `Trust.weight` | mean of the weights along and across the motion | – |
| b | `Trust.skew` | half of their difference, times e² with e the direction of motion | – |
| W z | `weighted` | w z + b conj(z): the first weight along e, the second across | – |
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.control.plane import shorten

LEAST_EXCESS = 0.02
"""Square of the relative excess that counts as none [–]; its inverse is the greatest weight."""
GREATEST_WEIGHT = 1.0 / LEAST_EXCESS
EXCESS_SHARE = 0.2
"""Excess of speed, as a share of the neighbour's top speed, of which the square halves as `LEAST_EXCESS`
does [–]."""
ACROSS_SHARE = 0.7
"""The same for its position across its motion [–]."""


class Trust(NamedTuple):
    """How a neighbour counts."""

    weight: float
    """Of its velocity; mean of the weights of its position in all directions [–]."""
    skew: complex
    """By which the weights of its position differ with the direction [–; world frame]."""


FULL_TRUST = Trust(1.0, 0j)
"""Of every neighbour where sums count."""


def trust(velocity: complex, leader_speed: float, top_speed: float) -> Trust:
    """Trust in a neighbour that moves at `velocity` [m/s; world frame], relative to its slot in the shape.

    `leader_speed` is the leader's top speed, `top_speed` that of the neighbour's control point [m/s].
    """
    speed = math.sqrt(velocity.real * velocity.real + velocity.imag * velocity.imag)
    if speed <= leader_speed:
        return Trust(GREATEST_WEIGHT, 0j)
    direction, excess = velocity * (1.0 / speed), speed - leader_speed
    along = _weight(excess / (EXCESS_SHARE * top_speed))
    across = _weight(excess / (ACROSS_SHARE * top_speed))
    return Trust(0.5 * (along + across), 0.5 * (along - across) * direction * direction)


def _weight(excess: float) -> float:
    return 1.0 / (LEAST_EXCESS + excess * excess)


def weighted(weight: float, skew: complex, vector: complex) -> complex:
    """W z for a `vector` z in the frame of `skew`."""
    return weight * vector + skew * vector.conjugate()


def mean(weight: float, skew: complex, total: complex) -> complex:
    """The weighted mean, by Σ W z as `total`, Σ w and Σ b."""
    determinant = weight * weight - skew.real * skew.real - skew.imag * skew.imag
    return (1.0 / determinant) * (weight * total - skew * total.conjugate())


def believed(velocity: complex, leader_speed: float) -> complex:
    """The formation's velocity [m/s] by its neighbours' mean: the leader is never faster."""
    return shorten(velocity, leader_speed)
