from __future__ import annotations

import cmath
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.observer import Travel, innovation, mended, printed, printed_start
from formation.control.unicycle import advance
from tests.unit.formation import oracle
from tests.unit.formation.planar import gains, headings, pair, vectors

distances = st.floats(-0.5, 0.5)
turns = st.floats(-1.0, 1.0)
ways = st.lists(st.tuples(distances, turns), min_size=1, max_size=8)


def along(heading: complex, distance: float, turn: float) -> tuple[Travel, complex]:
    """One arc: its odometry and the true heading at its end."""
    position, after = advance(0j, heading, distance, turn, 1.0)
    return Travel(distance, turn, position), after


@given(headings, vectors, ways, gains)
def test_heading_error_rotates_with_robot_and_decays_with_distance(
    heading: complex, estimate: complex, way: list[tuple[float, float]], gain: float
) -> None:
    """Forwards and backwards, for any division of the path into intervals."""
    before = estimate - heading
    for arc in way:
        travel, heading = along(heading, *arc)
        estimate = innovation(estimate, travel, gain)
    path, turned = sum(abs(distance) for distance, _ in way), sum(turn for _, turn in way)
    # the mean heading of a curved arc is shorter than one: chord over arc
    short = sum(1.0 - np.sinc(turn / (2.0 * np.pi)) for _, turn in way)
    left = before * cmath.rect(np.exp(-gain * path), turned)
    assert estimate - heading == pytest.approx(left, abs=1e-9 + short)


@given(headings, vectors, turns, gains)
def test_estimate_ignores_position_noise_at_rest(
    heading: complex, estimate: complex, turn: float, gain: float
) -> None:
    noisy = along(heading, 0.0, turn)[0]._replace(displacement=0.01 + 0.02j)
    assert innovation(estimate, noisy, gain) == pytest.approx(cmath.rect(1.0, turn) * estimate, abs=1e-9)


def test_printed_observer_diverges_and_mended_observer_converges() -> None:
    def error(observe: Callable[[complex, Travel, float], complex]) -> float:
        heading, estimate = 1.0 + 0j, 0j
        for step in range(2000):
            turn = 0.02 * np.sin(0.01 * step)
            travel, heading = along(heading, 0.01, turn)
            estimate = observe(estimate, travel, 5.0)
        return abs(estimate - heading)

    assert error(mended) < 0.05
    assert error(printed) > 10.0


def test_only_innovation_form_converges_in_reverse() -> None:
    heading = 1.0 + 0j
    mended_estimate = innovated = cmath.rect(1.0, 0.1)
    for _ in range(200):
        travel, heading = along(heading, -0.01, 0.001)
        mended_estimate = mended(mended_estimate, travel, 5.0)
        innovated = innovation(innovated, travel, 5.0)
    assert abs(mended_estimate - heading) > 100.0
    assert abs(innovated - heading) < 1e-3


@given(vectors, gains)
def test_printed_first_estimate_is_gain_times_position(position: complex, gain: float) -> None:
    estimate, _ = oracle.observer(np.zeros(2), pair(position), 0.0, 0.0, gain)
    assert pair(printed_start(position, gain)) == pytest.approx(estimate, abs=1e-9)


@given(vectors, vectors, st.floats(-1.0, 1.0), st.floats(-2.0, 2.0), vectors, gains)
def test_mended_observer_step_equals_equation_3(
    estimate: complex, position: complex, speed: float, turn_rate: float, velocity: complex, gain: float
) -> None:
    dt = 0.05
    chi = pair(estimate - gain * position)
    _, chi_rate = oracle.observer(chi, pair(position), speed, turn_rate, gain)
    after, _ = oracle.observer(chi + dt * chi_rate, pair(position + dt * velocity), 0.0, 0.0, gain)
    travel = Travel(speed * dt, turn_rate * dt, velocity * dt)
    assert pair(mended(estimate, travel, gain)) == pytest.approx(after, abs=1e-9)
