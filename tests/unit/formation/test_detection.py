"""Cylinders of a known radius in range scans (`formation.sensing.detection`)."""

from __future__ import annotations

import cmath
import math
import random
import statistics
from collections.abc import Iterable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.ros2.laser_scan import LaserScan
from formation.sensing.detection import (
    Beams,
    Detection,
    around,
    beams,
    covered,
    detection,
    expected_beams,
)
from formation.sensing.raycast import Scanner, cast, measured

EXACT = Scanner(noise=0.0, relative_noise=0.0)
LDS = Scanner(lost=0.1)


def scanned(discs: Iterable[tuple[complex, float]], scanner: Scanner = EXACT, seed: int = 0) -> LaserScan:
    """The scan of a scanner at the origin."""
    chance = random.Random(seed)
    true = cast(0j, 1.0 + 0.0j, discs, (), scanner.beams)
    normal, uniform = [chance.gauss(0.0, 1.0) for _ in true], [chance.random() for _ in true]
    ranges = measured(true, scanner, normal, uniform)
    return LaserScan(0.0, 0.0, math.tau / scanner.beams, scanner.range_min, scanner.range_max, ranges)


def found(scan: LaserScan, radius: float) -> list[Detection]:
    """Every whole cylinder of `radius` [m] in the scan."""
    divided = beams(scan)
    every = [detection(one, divided, radius) for one in divided.segments]
    return [one for one in every if one is not None and one.whole]


AHEAD = scanned([(1.0 + 0.0j, 0.1)])
"""A cylinder of 0.1 m, 1 m ahead."""


@given(st.floats(-math.pi, math.pi), st.floats(0.4, 1.5), st.sampled_from([0.035, 0.1]))
def test_detection_finds_cylinder_at_its_position(angle: float, distance: float, radius: float) -> None:
    centre = cmath.rect(distance, angle)
    (one,) = found(scanned([(centre, radius)]), radius)
    assert abs(cmath.rect(one.distance, one.angle) - centre) < 0.01 + distance * math.radians(0.5)


@pytest.mark.parametrize(("radius", "distance"), [(0.035, 1.0), (0.1, 1.0), (0.1, 2.0)])
def test_detected_centre_has_no_bias_and_stated_variance(radius: float, distance: float) -> None:
    ranges, angles, squares = [], [], []
    for seed in range(400):
        angle = 0.37 * seed
        for one in found(scanned([(cmath.rect(distance, angle), radius)], LDS, seed), radius):
            ranges.append(one.distance - distance)
            angles.append(math.remainder(one.angle - angle, math.tau))
            squares.append(ranges[-1] ** 2 / one.distance_variance)
    assert len(ranges) > 0.95 * 400
    assert abs(statistics.mean(ranges)) < 3e-3
    assert statistics.pstdev(angles) < math.radians(0.4)
    assert 0.5 < statistics.mean(squares) < 1.6


def test_cylinders_of_other_radius_are_not_detected() -> None:
    scan = scanned([(1.0 + 0.0j, 0.2), (1.0j, 0.02)])
    assert found(scan, 0.1) == []
    assert len(found(scan, 0.2)) == len(found(scan, 0.02)) == 1


def test_partly_hidden_cylinder_is_not_used() -> None:
    assert found(scanned([(1.0 + 0.0j, 0.1), (0.6 + 0.07j, 0.05)]), 0.1) == []


def test_cylinder_across_first_beam_gives_one_segment() -> None:
    divided = beams(AHEAD)
    (one,) = divided.segments
    assert (one.first, one.last) == (355, 365)
    assert expected_beams(0.1, 1.0, math.tau / 360) == pytest.approx(11, abs=1.0)
    assert detection(one, divided, 0.1) is not None


def test_segments_of_half_turn_scan_do_not_wrap() -> None:
    half = beams(replace(AHEAD, ranges=AHEAD.ranges[:180]))
    assert not half.whole_turn
    assert [one.last for one in half.segments] == [5]


@pytest.mark.parametrize("increment", [math.tau / 360, -math.tau / 360])
def test_beam_angle_inverts_beam_number_in_both_directions(increment: float) -> None:
    scan = Beams((), 0.5, increment, 360, 3.5)
    for angle in (-3.0, 0.2, 0.49, 0.51, 3.0):
        assert math.remainder(scan.angle(scan.number(angle)) - angle, math.tau) == pytest.approx(0.0)


def test_around_and_covered_select_segments_by_direction() -> None:
    divided = beams(scanned([(1.0 + 0.0j, 0.1), (1.0j, 0.1)]))
    ahead = list(around(divided, 0.0, 0.01))
    assert [one.middle % 360 for one in ahead] == [0.0]
    assert covered(divided, ahead, 0.0, math.radians(5.0)) == pytest.approx(1.0)
    assert covered(divided, ahead, 0.0, math.radians(11.0)) == pytest.approx(0.5)
    assert list(around(divided, math.pi, 0.1)) == []


@pytest.mark.parametrize("lost", [0.0, math.inf, math.nan])
def test_lost_beams_do_not_divide_a_cylinder(lost: float) -> None:
    ranges = [lost if number in {2, 357} else distance for number, distance in enumerate(AHEAD.ranges)]
    assert len(found(replace(AHEAD, ranges=tuple(ranges)), 0.1)) == 1
