"""The paper's equations for one robot, literally: vectors in R² and 2×2 matrices, no complex numbers.

The reference of the tests; it imports nothing of the product. Erratum 1 is corrected (Eq. (3) with
-k u ζ̂), z_ij is of control points, and χ(0) = 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
J = np.array([[0.0, -1.0], [1.0, 0.0]])


def frame(heading: Array) -> Array:
    """Eq. (2): R = [ζ, η] with η = J ζ."""
    return np.column_stack([heading, J @ heading])


def kinematics(heading: Array, speed: float, turn_rate: float) -> tuple[Array, Array]:
    """Eq. (1): dp and dζ."""
    return speed * heading, turn_rate * (J @ heading)


def observer(chi: Array, position: Array, speed: float, turn_rate: float, k: float) -> tuple[Array, Array]:
    """Eq. (3): ζ̂ and dχ."""
    estimate = chi + k * position
    return estimate, turn_rate * (J @ estimate) - k * speed * estimate


def weighted_mean(trusts: Sequence[tuple[float, complex]], vectors: Sequence[complex]) -> complex:
    """The mean of vectors with weights w ± |b| along and across a direction with the square b/|b|.

    `trusts` are (w, b).
    """
    matrices = [np.array([[w + b.real, b.imag], [b.imag, w - b.real]]) for w, b in trusts]
    total = sum(
        (matrix @ [one.real, one.imag] for matrix, one in zip(matrices, vectors, strict=True)), np.zeros(2)
    )
    return complex(*np.linalg.solve(sum(matrices, np.zeros((2, 2))), total))


def control_point_velocity(heading: Array, speed: float, turn_rate: float, offset: float) -> Array:
    """Eq. (4): dh = B [u, ω], B = [ζ, L η]."""
    input_matrix = np.column_stack([heading, offset * (J @ heading)])
    velocity: Array = input_matrix @ np.array([speed, turn_rate])
    return velocity


def nominal(
    measured: Sequence[Array],
    desired: Sequence[Array],
    integral: Array,
    estimate: Array,
    k_p: float,
    k_i: float,
) -> Array:
    """Eq. (7): [u_r, L ω_r], from z_ij^(i) and z*_ij of each neighbour and the integral so far."""
    to_body = frame(estimate).T
    proportional = np.zeros(2)
    for z, wanted in zip(measured, desired, strict=True):
        proportional += z - to_body @ wanted
    reference: Array = k_p * proportional + k_i * (to_body @ integral)
    return reference


def integrand(measured: Sequence[Array], desired: Sequence[Array], estimate: Array) -> Array:
    """The integrand of Eq. (7)."""
    total = np.zeros(2)
    for z, wanted in zip(measured, desired, strict=True):
        total += frame(estimate) @ z - wanted
    return total


def saturated(reference: Array, offset: float, max_speed: float, max_turn_rate: float) -> tuple[float, float]:
    """Eqs. (8) and (9): u and ω."""
    speed, turn_rate = float(reference[0]), float(reference[1]) / offset
    s_u = 1.0 if abs(speed) <= max_speed else max_speed / abs(speed)
    s_w = 1.0 if abs(turn_rate) <= max_turn_rate else max_turn_rate / abs(turn_rate)
    return s_u * speed, s_w * turn_rate
