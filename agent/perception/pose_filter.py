r"""The robot's own pose in the fleet's frame: odometry, corrected by where it sees its neighbours.

An extended Kalman filter, pure and in plain numbers. Its state is the centre p [m; fleet's frame], the
heading θ [rad] and the drift b of odometry's heading [rad/s]; deviations are in the order (x, y, θ, b).

| symbol | meaning |
|---|---|
| d, Δ, τ | motion by odometry [m; body frame before it], turn [rad], its duration [s] |
| c | published centre of a neighbour [m; fleet's frame] |
| m | place of the scanner [m; body frame] |
| w = c - p - exp(iθ) m | from the scanner to the neighbour [m; fleet's frame] |

Odometry:  p += exp(iθ) d,  θ += Δ - b τ.   Seen:  range |w|, bearing arg(w) - θ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.control.plane import rotation

PATH_DEVIATION = 0.005
"""Error of odometry's position on a path of 1 m, per axis [m]; it grows with the square root of the path."""
HEADING_DEVIATION = 5e-4
"""Error of odometry's heading in 1 s [rad]; it grows with the square root of the time."""
DRIFT_CHANGE = 2e-6
"""Change of the heading's drift in 1 s [rad/s]; it grows with the square root of the time."""
FIRST_DRIFT_DEVIATION = 2e-4
"""Standard deviation of the heading's drift at first [rad/s]."""
MAX_NORMALISED_SQUARE = 16.0
"""Squared innovation in units of its variance, beyond which a measurement is not used."""

Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]


class Estimate(NamedTuple):
    """The pose, and how uncertain it is."""

    position: complex
    """Centre [m; fleet's frame]."""
    heading: complex
    """Unit [fleet's frame]."""
    drift: float
    """Of odometry's heading [rad/s]."""
    covariance: Matrix
    """Of the deviations (x, y, θ, b) [m; rad; rad/s]."""


class Measurement(NamedTuple):
    """What a measurement should be, how it depends on the state, and what it was."""

    innovation: float
    """Measured less expected [m or rad]."""
    jacobian: Row
    """Of the expected value by the deviations."""
    variance: float
    """Of the measured value [m² or rad²]."""


def first(
    position: complex, heading: complex, position_deviation: float, heading_deviation: float
) -> Estimate:
    """The estimate of a pose that is known so well [m, per axis; rad]."""
    return Estimate(
        position, heading, 0.0, _diagonal(position_deviation, heading_deviation, FIRST_DRIFT_DEVIATION)
    )


def doubted(before: Estimate, position_deviation: float, heading_deviation: float) -> Estimate:
    """The same pose, known only so well [m, per axis; rad]; the drift stays as well known."""
    drift_deviation = math.sqrt(max(0.0, before.covariance[3][3]))
    return before._replace(covariance=_diagonal(position_deviation, heading_deviation, drift_deviation))


def widened(before: Estimate, position_deviation: float, heading_deviation: float) -> Estimate:
    """The same pose with an independent error added [standard deviations: m, per axis; rad]."""
    more = _diagonal(position_deviation, heading_deviation, 0.0)
    rows = [
        [value + extra for value, extra in zip(row, other, strict=True)]
        for row, other in zip(before.covariance, more, strict=True)
    ]
    return before._replace(covariance=_matrix(rows))


def moved(before: Estimate, motion: complex, turn: float, elapsed: float) -> Estimate:
    """The estimate after a motion by odometry, `motion` [m; body frame before] and `turn` [rad]."""
    step = before.heading * motion
    heading = before.heading * rotation(turn - before.drift * elapsed)
    rows = [list(row) for row in before.covariance]
    across, along = -step.imag, step.real  # derivative of the step by the heading
    for column in range(4):  # F P, with F the identity but for three entries
        rows[0][column] += across * rows[2][column]
        rows[1][column] += along * rows[2][column]
        rows[2][column] -= elapsed * rows[3][column]
    for row in rows:  # (F P) Fᵀ
        row[0] += across * row[2]
        row[1] += along * row[2]
        row[2] -= elapsed * row[3]
    path = PATH_DEVIATION * PATH_DEVIATION * abs(motion)
    rows[0][0] += path
    rows[1][1] += path
    rows[2][2] += HEADING_DEVIATION * HEADING_DEVIATION * elapsed
    rows[3][3] += DRIFT_CHANGE * DRIFT_CHANGE * elapsed
    return Estimate(before.position + step, heading / abs(heading), before.drift, _matrix(rows))


def expected(estimate: Estimate, centre: complex, scanner: complex) -> complex:
    """From the scanner at `scanner` [m; body frame] to `centre` [m; fleet's frame], in the body frame [m]."""
    return (centre - estimate.position) * estimate.heading.conjugate() - scanner


def sightline(
    estimate: Estimate, centre: complex, scanner: complex, seen: complex, variances: tuple[float, float]
) -> tuple[Measurement, Measurement]:
    """Range and bearing of a neighbour with the published `centre` [m; fleet's frame].

    `seen` is from the scanner to it [m; body frame], `variances` are of range [m²] and bearing [rad²]. The
    scanner is at `scanner` [m; body frame]: where it was, if the robot has moved since.
    """
    there = expected(estimate, centre, scanner)
    distance = abs(there)
    ray = estimate.heading * there / distance  # unit [fleet's frame]
    lever = 1j * estimate.heading * scanner  # how the scanner moves as the robot turns
    by_heading = -(lever * ray.conjugate())
    in_range: Row = (-ray.real, -ray.imag, by_heading.real, 0.0)
    in_bearing: Row = (ray.imag / distance, -ray.real / distance, by_heading.imag / distance - 1.0, 0.0)
    turned = seen * there.conjugate()
    return (
        Measurement(abs(seen) - distance, in_range, variances[0]),
        Measurement(math.atan2(turned.imag, turned.real), in_bearing, variances[1]),
    )


def squared_distance(estimate: Estimate, one: Measurement, other: Measurement) -> float:
    """Squared Mahalanobis distance of two measurements together."""
    first_side, second_side = (
        _times(estimate.covariance, one.jacobian),
        _times(estimate.covariance, other.jacobian),
    )
    a = _dot(one.jacobian, first_side) + one.variance
    b = _dot(one.jacobian, second_side)
    c = _dot(other.jacobian, second_side) + other.variance
    x, y = one.innovation, other.innovation
    return (c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b)


def deviation(estimate: Estimate, sight: tuple[Measurement, Measurement], distance: float) -> float:
    """Standard deviation of a place at `distance` [m] relative to the robot, by range and bearing [m]."""
    along, aside = (_dot(one.jacobian, _times(estimate.covariance, one.jacobian)) for one in sight)
    return math.sqrt(max(0.0, along + distance * distance * aside))


def updated(estimate: Estimate, measurement: Measurement) -> Estimate | None:
    """The estimate after a measurement; None if that is too improbable to be used."""
    innovation, jacobian, variance = measurement
    gain = _times(estimate.covariance, jacobian)
    total = _dot(jacobian, gain) + variance
    if not innovation * innovation <= MAX_NORMALISED_SQUARE * total:
        return None
    share = innovation / total
    rows = [
        [value - mine * other / total for value, other in zip(row, gain, strict=True)]
        for row, mine in zip(estimate.covariance, gain, strict=True)
    ]
    heading = estimate.heading * rotation(gain[2] * share)
    return Estimate(
        estimate.position + complex(gain[0], gain[1]) * share,
        heading / abs(heading),
        estimate.drift + gain[3] * share,
        _matrix(rows),
    )


def _diagonal(position: float, heading: float, drift: float) -> Matrix:
    return (
        (position * position, 0.0, 0.0, 0.0),
        (0.0, position * position, 0.0, 0.0),
        (0.0, 0.0, heading * heading, 0.0),
        (0.0, 0.0, 0.0, drift * drift),
    )


def _matrix(rows: list[list[float]]) -> Matrix:
    """The symmetric matrix of the upper half."""
    (xx, xy, xt, xb), (_, yy, yt, yb), (_, _, tt, tb), (_, _, _, bb) = rows
    return (xx, xy, xt, xb), (xy, yy, yt, yb), (xt, yt, tt, tb), (xb, yb, tb, bb)


def _times(matrix: Matrix, vector: Row) -> Row:
    a, b, c, d = [_dot(row, vector) for row in matrix]
    return a, b, c, d


def _dot(row: Row, other: Row) -> float:
    return row[0] * other[0] + row[1] * other[1] + row[2] * other[2] + row[3] * other[3]
