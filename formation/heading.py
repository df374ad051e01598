"""Heading from positions: two observers of ζ, neither of which measures it.

Source: Eq. (3) of the paper (after Yan et al., 2024). Both run on odometry intervals rather than on a
clock: the error falls by e^{-k·distance}, so the gain k has unit 1/m and the rate of samples does not matter.

Errata of Eq. (3): it prints `- k ω ζ̂`, which diverges; the error equation de = (iω - k u) e needs
`- k u ζ̂`. And χ(0) = 0 makes the first estimate k p(0), a matter of where the world's origin is.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from formation.plane import Reals, Vectors, rotation


class Travel(NamedTuple):
    """One odometry interval of a robot; scalars or arrays of one shape."""

    distance: Any
    """Signed path length Δs [m]; negative while reversing."""
    turn: Any
    """Turn Δθ [rad]."""
    displacement: Any
    """Change of position Δp [m; world frame]."""


def printed_start(position: Vectors, gain: Reals) -> Vectors:
    """The first estimate of the printed observer, χ(0) = 0, therefore ζ̂(0) = k p(0)."""
    estimate: Vectors = gain * position
    return estimate


def printed(
    estimate: Vectors, travel: Travel, gain: Reals, decay: Literal["speed", "turn rate"] = "speed"
) -> Vectors:
    """Observer (3), ζ̂ = χ + k p, one interval on; the estimate need not have unit length.

    `decay="speed"` is the mended equation, `decay="turn rate"` the one the paper prints (it diverges).
    """
    decayed = travel.distance if decay == "speed" else travel.turn
    chi_change = 1j * travel.turn * estimate - gain * decayed * estimate
    new_estimate: Vectors = estimate + chi_change + gain * travel.displacement
    return new_estimate


def innovation(estimate: Vectors, travel: Travel, gain: Reals) -> Vectors:
    """The same observer in innovation form, exact in discrete time and safe in reverse; not in the paper.

    Predict by the turn, then move towards the heading that the displacement shows at the interval's end,
    m = e^{iΔθ/2} Δp/Δs, by the share 1 - e^{-k|Δs|}: ζ̂ - ζ turns with the robot and shrinks by e^{-k|Δs|},
    however the way is cut into intervals. Written so that Δs = 0 needs no division: then nothing is learned.
    The law takes ζ̂/|ζ̂|, but the estimate itself must keep its length: a guess that points backwards has to
    come through zero, and normalised at every step it would be repelled from there and turn the long way.
    """
    path = np.abs(travel.distance)
    share = -np.expm1(-gain * path)
    half = rotation(0.5 * travel.turn)
    # share/Δs, whose limit at Δs = 0 is ±k; a robot at rest has no sign and learns nothing
    slope = np.sign(travel.distance) * np.where(path > 1e-9, share / np.maximum(path, 1e-9), gain)
    corrected: Vectors = (1.0 - share) * half * half * estimate + slope[()] * half * travel.displacement
    return corrected
