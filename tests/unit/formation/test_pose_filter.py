"""The filter of a robot's own pose: noise, reversing, and motion that the robot did not command."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.controller import fastest_gain
from formation.control.observer import Travel
from formation.control.pose_filter import ODOMETRY_NOISE, filtered, first_spread, least_noise
from formation.control.unicycle import advance

LEAST, STEP = least_noise(0.002), 0.02


def driven(
    speed: float, turn_rate: float, noise: float, steps: int, offset: complex = 0j, guess: float = 2.0
) -> tuple[float, float]:
    """Errors of position [m] and heading [rad] after `steps`; `offset` [m/s] is added to its velocity."""
    random = np.random.default_rng(1)
    position, heading = 1.0 + 2.0j, cmath.rect(1.0, 0.3)
    seen, believed = position, position
    estimate, spread = cmath.rect(1.0, 0.3 + guess), first_spread(LEAST)
    for _ in range(steps):
        position, heading = advance(position, heading, speed, turn_rate, STEP)
        position += offset * STEP
        measured = position + noise * complex(*random.normal(0.0, 1.0, 2))
        travel, seen = Travel(speed * STEP, turn_rate * STEP, measured - seen), measured
        believed, estimate, spread = filtered(
            believed, estimate, spread, travel, measured, STEP, LEAST, ODOMETRY_NOISE
        )
    return abs(believed - position), abs(cmath.phase(estimate / heading))


@given(st.floats(0.05, 1.5), st.floats(-2.0, 2.0), st.sampled_from([1.0, -1.0]), st.floats(-2.5, 2.5))
def test_heading_is_estimated_forwards_and_backwards(
    speed: float, turn_rate: float, sign: float, guess: float
) -> None:
    away, turned = driven(sign * speed, turn_rate, 0.0, 500, guess=guess)
    assert away < 1e-3
    assert turned < 1e-2


@pytest.mark.parametrize("noise", [0.002, 0.005, 0.02])
def test_filtered_position_is_better_than_measured(noise: float) -> None:
    away, turned = driven(0.2, 0.1, noise, 3000)
    assert away < 0.7 * noise
    assert turned < 0.05


def test_position_of_carried_robot_follows_measurement() -> None:
    away, _ = driven(0.0, 0.0, 0.0, 500, offset=0.8 + 0.0j)
    assert away < 0.1


@given(st.floats(0.0, 1.0), st.floats(0.005, 0.5), st.integers(0, 30))
def test_fastest_gain_leaves_three_periods_of_delay_margin(lag: float, period: float, cycle: int) -> None:
    gain = fastest_gain(lag, period, cycle, 0.04)
    assert 0.0 < gain <= 12.0
    assert 0.5 * math.pi / gain >= 3.0 * period
    assert gain * lag <= 0.5
