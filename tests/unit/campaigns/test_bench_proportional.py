"""The proportional laws of the benchmarks follow their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from formation.control.controller import Gains, Limits, Measured, Step
from formation.control.unicycle import Command
from tests.campaigns.bench import control_trials
from tests.campaigns.bench.control_trials import PROPORTIONAL, ROBOTARIUM, Contender

GAINS, LIMITS = Gains(10.0, 0.0), Limits(0.2, 1.5, 1.5)


def commanded(law: Step, wanted: complex) -> Command:
    """Command of a robot that points along x and is to move at `wanted` [m/s]."""
    command, _ = law(0j, 1.0 + 0.0j, Measured(wanted / GAINS.k_p, 0j, 1), GAINS, LIMITS, 0.02)
    return command


@pytest.mark.parametrize("law", [control_trials.turning, control_trials.near_identity])
def test_proportional_law_uses_at_most_three_quarters_speed(law: Step) -> None:
    assert commanded(law, 100.0 + 0j).speed <= 0.75 * LIMITS.max_speed + 1e-12


def test_near_identity_mapping_gives_control_point_wanted_velocity() -> None:
    command = commanded(control_trials.near_identity, 0.3 + 0.1j)
    assert command.speed == pytest.approx(0.3)
    assert LIMITS.offset * command.turn_rate == pytest.approx(0.1)


def test_turning_mapping_turns_towards_wanted_velocity() -> None:
    command = commanded(control_trials.turning, 0.3 + 0.1j)
    assert command.speed == pytest.approx(0.8 * 0.3)
    assert command.turn_rate == pytest.approx(2.0 * np.angle(0.3 + 0.1j))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contender", "speed"), [(PROPORTIONAL, 1.0), (ROBOTARIUM, 0.8)], ids=["near identity", "turning"]
)
def test_final_error_is_speed_over_gain_per_robot(contender: Contender, speed: float) -> None:
    result = contender.drive(control_trials.six_robots(), 5, 30.0)
    assert result.final_error == pytest.approx(5 * 0.2 / (10.0 * speed), rel=1e-3)
