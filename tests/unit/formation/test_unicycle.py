from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.unicycle import (
    Command,
    advance,
    body_velocity,
    control_point,
    control_point_velocity,
    driven,
    saturate,
)
from tests.unit.formation import oracle
from tests.unit.formation.planar import headings, lengths, pair, vectors

rates = st.floats(-3.0, 3.0)


@given(vectors, headings, rates, rates)
def test_the_arc_solves_the_kinematics(
    position: complex, heading: complex, speed: float, turn_rate: float
) -> None:
    dt, step = 0.7, 1e-5
    at, before, after = (advance(position, heading, speed, turn_rate, dt + d) for d in (0.0, -step, step))
    velocity, turning = oracle.kinematics(pair(at[1]), speed, turn_rate)
    assert pair((after[0] - before[0]) / (2.0 * step)) == pytest.approx(velocity, abs=1e-7)
    assert pair((after[1] - before[1]) / (2.0 * step)) == pytest.approx(turning, abs=1e-7)


@given(vectors, headings, rates, rates, st.floats(0.0, 1.0))
def test_an_arc_may_be_cut_anywhere(
    position: complex, heading: complex, speed: float, turn_rate: float, share: float
) -> None:
    whole = advance(position, heading, speed, turn_rate, 2.0)
    halfway = advance(position, heading, speed, turn_rate, 2.0 * share)
    rest = advance(*halfway, speed, turn_rate, 2.0 * (1.0 - share))
    assert rest[0] == pytest.approx(whole[0], abs=1e-9)
    assert rest[1] == pytest.approx(whole[1], abs=1e-9)


@given(vectors, headings, rates)
def test_without_turning_the_way_is_straight(position: complex, heading: complex, speed: float) -> None:
    there, facing = advance(position, heading, speed, 0.0, 1.5)
    assert there == pytest.approx(position + 1.5 * speed * heading, abs=1e-12)
    assert facing == heading


@given(vectors, headings, rates, rates)
def test_driving_back_the_same_arc_leads_home(
    position: complex, heading: complex, speed: float, turn_rate: float
) -> None:
    there = advance(position, heading, speed, turn_rate, 1.0)
    home = advance(*there, -speed, -turn_rate, 1.0)
    assert home[0] == pytest.approx(position, abs=1e-9)
    assert home[1] == pytest.approx(heading, abs=1e-9)


@given(headings, rates, rates, lengths)
def test_the_control_point_moves_as_equation_4_says(
    heading: complex, speed: float, turn_rate: float, offset: float
) -> None:
    velocity = control_point_velocity(heading, speed, turn_rate, offset)
    assert pair(velocity) == pytest.approx(
        oracle.control_point_velocity(pair(heading), speed, turn_rate, offset), abs=1e-9
    )
    assert heading.conjugate() * velocity == pytest.approx(body_velocity(speed, turn_rate, offset), abs=1e-9)


@given(vectors, headings, rates, rates, lengths)
def test_that_velocity_is_the_derivative_of_the_control_point(
    position: complex, heading: complex, speed: float, turn_rate: float, offset: float
) -> None:
    dt = 1e-6
    before = control_point(*advance(position, heading, speed, turn_rate, -dt), offset)
    after = control_point(*advance(position, heading, speed, turn_rate, dt), offset)
    expected = control_point_velocity(heading, speed, turn_rate, offset)
    assert (after - before) / (2.0 * dt) == pytest.approx(expected, abs=1e-6)


@given(vectors, lengths, lengths, lengths)
def test_saturation_is_equation_8_to_the_letter(
    nominal: complex, offset: float, max_speed: float, max_turn_rate: float
) -> None:
    command = saturate(nominal, offset, max_speed, max_turn_rate)
    assert command == pytest.approx(
        oracle.saturated(pair(nominal), offset, max_speed, max_turn_rate), abs=1e-9
    )


def test_saturation_of_nothing_is_nothing() -> None:
    assert saturate(0j, 0.1, 1.0, 1.0) == (0.0, 0.0)


@given(rates, rates, st.floats(0.01, 1.0), st.floats(0.001, 0.5))
def test_lagging_wheels_agree_for_one_and_two_steps(
    before: float, reported: float, lag: float, dt: float
) -> None:
    moving, command = Command(before, 0.0), Command(reported, 0.0)
    whole, end = driven(moving, command, lag, dt)
    first, between = driven(moving, command, lag, dt / 2.0)
    second, same_end = driven(between, command, lag, dt / 2.0)
    assert same_end == pytest.approx(end, abs=1e-9)
    assert whole.speed == pytest.approx((first.speed + second.speed) / 2.0, abs=1e-9)
