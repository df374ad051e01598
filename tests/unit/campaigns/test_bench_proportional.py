"""The peers are what they are said to be."""

from __future__ import annotations

import numpy as np
import pytest

from formation.control.controller import Gains, Limits, Measured, Step
from formation.control.unicycle import Command
from tests.campaigns.bench import control_trials
from tests.campaigns.bench.control_trials import PROPORTIONAL, ROBOTARIUM, Contender

GAINS, LIMITS = Gains(10.0, 0.0), Limits(0.2, 1.5, 1.5)


def reported(law: Step, wanted: complex) -> Command:
    """What a robot that points along x is told when it wants `wanted` [m/s]."""
    command, _ = law(0j, 1.0 + 0.0j, Measured(wanted / GAINS.k_p, 0j, 1), GAINS, LIMITS, 0.02)
    return command


@pytest.mark.parametrize("law", [control_trials.turning, control_trials.near_identity])
def test_proportional_law_uses_at_most_three_quarters_speed(law: Step) -> None:
    assert reported(law, 100.0 + 0j).speed <= 0.75 * LIMITS.max_speed + 1e-12


def test_the_near_identity_mapping_gives_the_control_point_the_wanted_velocity() -> None:
    command = reported(control_trials.near_identity, 0.3 + 0.1j)
    assert command.speed == pytest.approx(0.3)
    assert LIMITS.offset * command.turn_rate == pytest.approx(0.1)


def test_the_turning_mapping_turns_towards_the_wanted_velocity() -> None:
    command = reported(control_trials.turning, 0.3 + 0.1j)
    assert command.speed == pytest.approx(0.8 * 0.3)
    assert command.turn_rate == pytest.approx(2.0 * np.angle(0.3 + 0.1j))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contender", "speed"), [(PROPORTIONAL, 1.0), (ROBOTARIUM, 0.8)], ids=["near identity", "turning"]
)
def test_every_robot_keeps_an_error_of_speed_over_gain(contender: Contender, speed: float) -> None:
    result = contender.drive(control_trials.six_robots(), 5, 30.0)
    assert result.final_error == pytest.approx(5 * 0.2 / (10.0 * speed), rel=1e-3)
