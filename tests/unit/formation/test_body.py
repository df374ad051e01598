from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.unicycle import Command, driven
from formation.mission.model import SimulatedRobot
from formation.simulation.body import PROFILES, Body, obeyed

rates = st.floats(-3.0, 3.0)


@given(rates, rates)
def test_an_ideal_body_does_at_once_what_it_is_told(speed: float, turn_rate: float) -> None:
    body, reported = Body(), Command(speed, turn_rate)
    assert obeyed(body, reported) == reported
    assert driven(Command(1.0, -1.0), reported, body.lag, 0.05) == (reported, reported)


@given(rates, rates)
def test_burger_respects_limits_and_steps_of_commands(speed: float, turn_rate: float) -> None:
    body = PROFILES["turtlebot3_burger"]
    done = obeyed(body, Command(speed, turn_rate))
    for did, reported, limit in zip(done, (speed, turn_rate), (0.2108, 2.635), strict=True):
        assert abs(did) <= limit
        assert abs(did) <= abs(reported) + 1e-6
        assert did * reported >= 0.0
        assert abs(did) == limit or did / 0.01 == pytest.approx(round(did / 0.01), abs=1e-6)


@pytest.mark.parametrize("hundredths", range(-21, 22))
def test_multiple_of_step_is_not_truncated(hundredths: int) -> None:
    speed, _ = obeyed(PROFILES["turtlebot3_burger"], Command(hundredths / 100.0, 0.0))
    assert speed == pytest.approx(hundredths / 100.0, abs=1e-12)


def test_a_mission_may_depart_from_its_profile() -> None:
    assert Body.of(SimulatedRobot()) == Body()
    weaker = Body.of(SimulatedRobot(profile="turtlebot3_burger", max_speed=0.1, speed_step=0.0))
    assert (weaker.max_speed, weaker.speed_step, weaker.turn_rate_step) == (0.1, 0.0, 0.01)
