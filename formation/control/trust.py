"""How much a neighbour counts: little while it is faster than the leader ever is; not in the paper.

A neighbour that catches up is neither where the formation wants it nor as fast. Its own speed shows that,
and nothing else need be communicated. All weights are equal in formation, so the equilibrium, and the linear
loop around it, are those of the plain mean.
"""

from __future__ import annotations

import math

from formation.control.plane import shorten

LEAST_EXCESS = 0.02
"""Square of the relative excess that counts as none [–]; its inverse is the greatest weight."""
GREATEST_WEIGHT = 1.0 / LEAST_EXCESS
EXCESS_SHARE = 0.2
"""Excess of speed, as a share of the neighbour's top speed, of which the square halves as `LEAST_EXCESS`
does [–]."""


def weight(velocity: complex, leader_speed: float, top_speed: float) -> float:
    """Weight of a neighbour that moves at `velocity` [m/s], relative to its slot's motion in the shape.

    `leader_speed` is the leader's top speed, `top_speed` that of the neighbour's control point [m/s].
    """
    squared = velocity.real * velocity.real + velocity.imag * velocity.imag
    if squared <= leader_speed * leader_speed:
        return GREATEST_WEIGHT
    excess = (math.sqrt(squared) - leader_speed) / (EXCESS_SHARE * top_speed)
    return 1.0 / (LEAST_EXCESS + excess * excess)


def believed(velocity: complex, leader_speed: float) -> complex:
    """The formation's velocity [m/s] by its neighbours' mean: the leader is never faster."""
    return shorten(velocity, leader_speed)
