"""Heading from positions: two observers of ζ, neither of which measures it.

Source: Eq. (3) of the paper (after Yan et al., 2024). Both run on odometry intervals rather than on a
clock: the error falls by e^{-k·distance}, so the gain k has unit 1/m and the rate of samples does not matter.

Errata of Eq. (3): it prints `- k ω ζ̂`, which diverges; the error equation de = (iω - k u) e needs
`- k u ζ̂`. And χ(0) = 0 makes the first estimate k p(0), a matter of where the world's origin is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from formation.control.plane import rotation


class Travel(NamedTuple):
    """One odometry interval of a robot."""

    distance: float
    """Signed path length Δs [m]; negative while reversing."""
    turn: float
    """Turn Δθ [rad]."""
    displacement: complex
    """Change of position Δp [m; world frame]."""


def printed_start(position: complex, gain: float) -> complex:
    """First estimate of the printed observer, χ(0) = 0, therefore ζ̂(0) = k p(0)."""
    return gain * position


def mended(estimate: complex, travel: Travel, gain: float) -> complex:
    """Observer (3), ζ̂ = χ + k p, after one interval; the estimate need not have unit length."""
    return _decayed(estimate, travel, gain, travel.distance)


def printed(estimate: complex, travel: Travel, gain: float) -> complex:
    """Observer (3) as printed, with its decay by the turn rate: it diverges."""
    return _decayed(estimate, travel, gain, travel.turn)


def _decayed(estimate: complex, travel: Travel, gain: float, decay: float) -> complex:
    chi_change = complex(-gain * decay, travel.turn) * estimate
    return estimate + chi_change + gain * travel.displacement


def innovation(estimate: complex, travel: Travel, gain: float) -> complex:
    """The same observer in innovation form, exact in discrete time and safe in reverse; not in the paper.

    Predict by the turn, then move towards the heading that the displacement shows at the interval's end,
    m = e^{iΔθ/2} Δp/Δs, by the share 1 - e^{-k|Δs|}: ζ̂ - ζ turns with the robot and shrinks by e^{-k|Δs|},
    however the way is cut into intervals. Written so that Δs = 0 needs no division: then nothing is learned.
    The law takes ζ̂/|ζ̂|, but the estimate itself must keep its length: a guess that points backwards has to
    come through zero, and normalised at every step it would be repelled from there and turn the long way.
    """
    path = abs(travel.distance)
    share = -math.expm1(-gain * path)
    half = rotation(0.5 * travel.turn)
    kept = (1.0 - share) * half * half * estimate
    if path > 1e-9:
        return kept + share / travel.distance * half * travel.displacement
    # share/Δs, with the limit ±k at Δs = 0; a robot at rest has no sign and learns nothing
    slope = gain if travel.distance > 0.0 else -gain if travel.distance < 0.0 else 0.0
    return kept + slope * half * travel.displacement


class Observer(NamedTuple):
    """An observer of the heading."""

    step: Callable[[complex, Travel, float], complex]
    """(estimate, travel, gain [1/m]) -> estimate one interval on."""
    start: Callable[[complex, float], complex] | None = None
    """(position [m; world frame], gain [1/m]) -> first estimate; None if it starts from a guess."""


INNOVATION = Observer(innovation)
MENDED = Observer(mended, printed_start)
PRINTED = Observer(printed, printed_start)
