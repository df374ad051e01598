"""Motion of one robot: vectors in the plane, arcs, limits, wheels."""

from __future__ import annotations

import cmath
import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.plane import angle_between, clip, rotation, shorten, unit
from formation.control.unicycle import (
    Command,
    advance,
    body_velocity,
    control_point,
    driven,
    saturate,
)
from formation.mission.model import SimulatedRobot
from formation.simulation.body import PROFILES, Body, obeyed
from formation.simulation.compiled import compiled
from tests.unit.formation import oracle
from tests.unit.formation.planar import angles, headings, lengths, pair, vectors


@given(angles)
def test_rotation_is_unit_vector_at_its_angle(angle: float) -> None:
    assert rotation(angle) == pytest.approx(cmath.rect(1.0, angle), abs=1e-12)


@given(vectors.filter(lambda vector: abs(vector) > 1e-6))
def test_unit_has_length_one_and_same_direction(vector: complex) -> None:
    assert abs(unit(vector)) == pytest.approx(1.0)
    assert (unit(vector) * vector.conjugate()).real == pytest.approx(abs(vector))
    assert (unit(0j), unit(0j, 1j)) == (1.0, 1j)


@given(st.floats(-10.0, 10.0), lengths)
def test_clip_keeps_within_the_limit_and_passes_nan(value: float, limit: float) -> None:
    clipped = clip(value, limit)
    assert -limit <= clipped <= limit
    assert clipped == value or abs(value) > limit
    assert math.isnan(clip(math.nan, limit))
    assert math.isnan(compiled(clip)(math.nan, limit))


@given(vectors, lengths)
def test_shorten_limits_length_and_keeps_direction(vector: complex, limit: float) -> None:
    shortened = shorten(vector, limit)
    assert abs(shortened) == pytest.approx(min(abs(vector), limit))
    assert (shortened * vector.conjugate()).imag == pytest.approx(0.0, abs=1e-9)


@given(angles, st.floats(-3.1, 3.1), lengths)
def test_angle_between_vectors_rotates_one_onto_other(angle: float, turn: float, length: float) -> None:
    first = complex(length * rotation(angle))
    assert angle_between(first, complex(first * rotation(turn))) == pytest.approx(turn, abs=1e-9)


rates = st.floats(-3.0, 3.0)


@given(vectors, headings, rates, rates)
def test_advance_solves_the_kinematics(
    position: complex, heading: complex, speed: float, turn_rate: float
) -> None:
    dt, step = 0.7, 1e-5
    at, before, after = (advance(position, heading, speed, turn_rate, dt + d) for d in (0.0, -step, step))
    velocity, turning = oracle.kinematics(pair(at[1]), speed, turn_rate)
    assert pair((after[0] - before[0]) / (2.0 * step)) == pytest.approx(velocity, abs=1e-7)
    assert pair((after[1] - before[1]) / (2.0 * step)) == pytest.approx(turning, abs=1e-7)


@given(vectors, headings, rates, rates, st.floats(0.0, 1.0))
def test_advance_in_two_parts_equals_one_arc(
    position: complex, heading: complex, speed: float, turn_rate: float, share: float
) -> None:
    whole = advance(position, heading, speed, turn_rate, 2.0)
    halfway = advance(position, heading, speed, turn_rate, 2.0 * share)
    rest = advance(*halfway, speed, turn_rate, 2.0 * (1.0 - share))
    assert rest[0] == pytest.approx(whole[0], abs=1e-9)
    assert rest[1] == pytest.approx(whole[1], abs=1e-9)


@given(vectors, headings, rates)
def test_advance_without_turning_is_straight(position: complex, heading: complex, speed: float) -> None:
    there, facing = advance(position, heading, speed, 0.0, 1.5)
    assert there == pytest.approx(position + 1.5 * speed * heading, abs=1e-12)
    assert facing == heading


@given(vectors, headings, rates, rates, lengths)
def test_control_point_velocity_matches_equation_4(
    position: complex, heading: complex, speed: float, turn_rate: float, offset: float
) -> None:
    velocity, dt = heading * body_velocity(speed, turn_rate, offset), 1e-6
    expected = oracle.control_point_velocity(pair(heading), speed, turn_rate, offset)
    assert pair(velocity) == pytest.approx(expected, abs=1e-9)
    before = control_point(*advance(position, heading, speed, turn_rate, -dt), offset)
    after = control_point(*advance(position, heading, speed, turn_rate, dt), offset)
    rounding = 2.0 * sys.float_info.epsilon * abs(position) / dt  # of the difference of two far points
    assert (after - before) / (2.0 * dt) == pytest.approx(velocity, abs=1e-6 + rounding)


@given(vectors | st.just(0j), lengths, lengths, lengths)
def test_saturate_equals_equation_8(
    nominal: complex, offset: float, max_speed: float, max_turn_rate: float
) -> None:
    expected = oracle.saturated(pair(nominal), offset, max_speed, max_turn_rate)
    assert saturate(nominal, offset, max_speed, max_turn_rate) == pytest.approx(expected, abs=1e-9)


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


@given(rates, rates)
def test_ideal_body_follows_command_at_once(speed: float, turn_rate: float) -> None:
    body, reported = Body(), Command(speed, turn_rate)
    assert obeyed(body, reported) == reported
    assert driven(Command(1.0, -1.0), reported, body.lag, 0.05) == (reported, reported)


@given(rates, rates)
def test_burger_respects_limits_and_steps_of_commands(speed: float, turn_rate: float) -> None:
    done = obeyed(PROFILES["turtlebot3_burger"], Command(speed, turn_rate))
    for did, reported, limit in zip(done, (speed, turn_rate), (0.2108, 2.635), strict=True):
        assert abs(did) <= limit
        assert abs(did) <= abs(reported) + 1e-6
        assert did * reported >= 0.0
        assert abs(did) == limit or did / 0.01 == pytest.approx(round(did / 0.01), abs=1e-6)


@pytest.mark.parametrize("hundredths", range(-21, 22))
def test_multiple_of_step_is_not_truncated(hundredths: int) -> None:
    speed, _ = obeyed(PROFILES["turtlebot3_burger"], Command(hundredths / 100.0, 0.0))
    assert speed == pytest.approx(hundredths / 100.0, abs=1e-12)


def test_simulated_robot_overrides_values_of_its_profile() -> None:
    assert Body.of(SimulatedRobot()) == Body()
    weaker = Body.of(SimulatedRobot(profile="turtlebot3_burger", max_speed=0.1, speed_step=0.0))
    assert (weaker.max_speed, weaker.speed_step, weaker.turn_rate_step) == (0.1, 0.0, 0.01)
