"""The filter of the own pose by odometry and seen neighbours (`formation.agent.perception.pose_filter`)."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.perception.pose_filter import (
    Estimate,
    Measurement,
    doubted,
    first,
    moved,
    sightline,
    squared_distance,
    updated,
    widened,
)
from formation.control.unicycle import along

SCANNER = -0.032 + 0.01j
EXACT = (1e-6, 1e-6)
"""Variances of a scanner without noise [m²; rad²]."""
angles = st.floats(-math.pi, math.pi)
offsets = st.complex_numbers(max_magnitude=0.08)
errors = st.floats(-0.08, 0.08)


def seen_from(position: complex, heading: complex, centre: complex) -> complex:
    """What an exact scanner shows [m; body frame]."""
    return (centre - position) / heading - SCANNER


def corrected(estimate: Estimate, seen: Sequence[tuple[complex, complex]]) -> Estimate:
    """The estimate after both measurements of all robots: centre [m; team's frame] and what is seen."""
    for centre, ray in seen:
        for which in (0, 1):
            measurement = sightline(estimate, centre, SCANNER, ray, EXACT)[which]
            estimate = updated(estimate, measurement) or estimate
    return estimate


@given(offsets, angles, errors, angles, st.floats(0.6, 2.5), st.floats(0.5, 2.6))
def test_exact_sights_of_two_give_the_pose(
    off: complex, facing: float, turned: float, bearing: float, distance: float, apart: float
) -> None:
    position, heading = 1.0 + 2.0j, cmath.rect(1.0, facing)
    centres = [position + cmath.rect(distance, one) for one in (bearing, bearing + apart)]
    rays = [seen_from(position, heading, one) for one in centres]
    estimate = first(position + off, heading * cmath.rect(1.0, turned), 0.05, math.radians(3.0))
    for _ in range(10):
        estimate = widened(
            corrected(estimate, list(zip(centres, rays, strict=True))), 0.01, math.radians(0.5)
        )
    assert abs(estimate.position - position) < 1e-3
    assert abs(estimate.heading - heading) < 1e-3


@given(errors, st.floats(-0.6, 0.6))
def test_motion_shows_heading_by_one_neighbour(turned: float, turn: float) -> None:
    position, heading, centre = 0j, 1.0 + 0.0j, 1.0 + 0.6j
    estimate = first(position, cmath.rect(1.0, turned), 0.05, math.radians(3.0))
    for _ in range(60):
        motion, _ = along(0j, 1.0 + 0.0j, 0.03, 0.05 * turn)
        position, heading = position + heading * motion, heading * cmath.rect(1.0, 0.05 * turn)
        centre += 0.03
        estimate = moved(estimate, motion, 0.05 * turn, 0.2)
        estimate = corrected(estimate, [(centre, seen_from(position, heading, centre))])
    # the rotation about the neighbour that the first sight left free has become visible
    assert abs(estimate.heading - heading) < max(2e-3, 0.3 * abs(turned))


def test_one_standing_neighbour_leaves_rotation_free() -> None:
    estimate = first(0j, 1.0 + 0.0j, 0.05, math.radians(3.0))
    for _ in range(100):
        estimate = corrected(estimate, [(1.0 + 0.0j, seen_from(0j, 1.0 + 0.0j, 1.0 + 0.0j))])
    assert estimate.heading_deviation > math.radians(1.0)
    assert math.sqrt(estimate.covariance[0][0]) < 0.01


@given(st.floats(0.0, 0.5), angles, st.floats(0.0, 1.0))
def test_motion_without_sight_never_reduces_doubt(way: float, turn: float, elapsed: float) -> None:
    before = first(1j, 1j, 0.02, 0.01)
    after = moved(before, complex(way), turn, elapsed)
    assert after.position_deviation >= before.position_deviation
    assert after.heading_deviation >= before.heading_deviation
    assert after.position == pytest.approx(1j + 1j * way)


@given(angles, st.complex_numbers(min_magnitude=0.3, max_magnitude=3.0), st.floats(0.5, 2.0))
def test_jacobians_are_derivatives(facing: float, away: complex, distance: float) -> None:
    estimate = first(0.3 - 0.2j, cmath.rect(1.0, facing), 0.05, 0.05)
    centre = estimate.position + away * distance / abs(away)
    ray = cmath.rect(1.0, 0.1)
    at = sightline(estimate, centre, SCANNER, ray, EXACT)
    step = 1e-6
    for column, other in enumerate(
        (
            estimate._replace(position=estimate.position + step),
            estimate._replace(position=estimate.position + step * 1j),
            estimate._replace(heading=estimate.heading * cmath.rect(1.0, step)),
        )
    ):
        for before, after in zip(at, sightline(other, centre, SCANNER, ray, EXACT), strict=True):
            change = math.remainder(before.innovation - after.innovation, math.tau)
            assert change / step == pytest.approx(before.jacobian[column], abs=1e-4)


def test_improbable_measurement_is_not_used() -> None:
    estimate = first(0j, 1.0 + 0.0j, 0.01, 0.01)
    assert updated(estimate, Measurement(0.1, (-1.0, 0.0, 0.0, 0.0), 1e-4)) is None
    assert updated(estimate, Measurement(0.03, (-1.0, 0.0, 0.0, 0.0), 1e-4)) is not None
    assert updated(estimate, Measurement(math.nan, (-1.0, 0.0, 0.0, 0.0), 1e-4)) is None


def test_doubt_replaces_all_but_the_drift() -> None:
    estimate = doubted(moved(first(0j, 1j, 1e-3, 1e-3), 0.1 + 0j, 0.0, 0.2), 0.05, 0.02)
    assert estimate.position_deviation == pytest.approx(0.05)
    assert estimate.heading_deviation == pytest.approx(0.02)
    assert estimate.covariance[0][2] == 0.0


def test_squared_distance_of_independent_measurements() -> None:
    estimate = first(0j, 1.0 + 0.0j, 0.0, 0.0)
    one = Measurement(0.3, (-1.0, 0.0, 0.0, 0.0), 0.01)
    other = Measurement(0.2, (0.0, 1.0, 0.0, 0.0), 0.04)
    assert squared_distance(estimate, one, other) == pytest.approx(9.0 + 1.0)
