from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission import SimulatedRobot
from formation.simulation.body import PROFILES, Body, obeyed
from formation.unicycle import Command, driven

rates = st.floats(-3.0, 3.0)


@given(rates, rates)
def test_an_ideal_body_does_at_once_what_it_is_told(speed: float, turn_rate: float) -> None:
    body, told = Body(), Command(speed, turn_rate)
    assert obeyed(body, told) == told
    assert driven(Command(1.0, -1.0), told, body.lag, 0.05) == (told, told)


@given(rates, rates)
def test_the_burger_keeps_to_its_clamps_and_steps_and_never_does_more_than_told(
    speed: float, turn_rate: float
) -> None:
    body = PROFILES["turtlebot3_burger"]
    done = obeyed(body, Command(speed, turn_rate))
    for did, told, limit in zip(done, (speed, turn_rate), (0.2108, 2.635), strict=True):
        assert abs(did) <= limit
        assert abs(did) <= abs(told) + 1e-6
        assert did * told >= 0.0
        assert abs(did) == limit or did / 0.01 == pytest.approx(round(did / 0.01), abs=1e-6)


@pytest.mark.parametrize("hundredths", range(-21, 22))
def test_a_command_that_is_a_multiple_of_the_step_is_not_cut(hundredths: int) -> None:
    speed, _ = obeyed(PROFILES["turtlebot3_burger"], Command(hundredths / 100.0, 0.0))
    assert speed == pytest.approx(hundredths / 100.0, abs=1e-12)


def test_a_mission_may_depart_from_its_profile() -> None:
    assert Body.of(SimulatedRobot()) == Body()
    weaker = Body.of(SimulatedRobot(profile="turtlebot3_burger", max_speed=0.1, speed_step=0.0))
    assert (weaker.max_speed, weaker.speed_step, weaker.turn_rate_step) == (0.1, 0.0, 0.01)
