"""A robot that cuts commands to hundredths drives, on average, exactly as the law wants it to."""

from __future__ import annotations

from statistics import fmean
from typing import Any

import pytest

from formation.control.unicycle import Command
from formation.mission.model import Mission
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.missions import with_robots
from tests.unit.agent.wished import Wishes


def pair(*, feedback: bool, leader_speed: float = 0.05) -> Mission:
    step = 0.01 if feedback else 0.0
    mission = with_robots("turtlebot3_pair", speed_step=step, turn_rate_step=step)
    (leg,) = mission.route
    return mission.model_copy(update={"route": (leg.model_copy(update={"speed": leader_speed}),)})


def means(mission: Mission) -> tuple[float, float]:
    """Mean forward speed over 10 s in formation: wanted by the law, and as the robot takes it [m/s]."""
    fleet, wanted = Fleet(mission).after(15.0), list[float]()
    agent, before = fleet.agents["robot1"], len(fleet.commands["robot1"])
    law = agent._params.law

    def overheard(*arguments: Any) -> tuple[Command, Any]:
        command, integral = law(*arguments)
        wanted.append(float(command.speed))
        return command, integral

    agent._params = agent._params._replace(law=overheard)
    fleet.run(10.0)
    reported = [int(speed * 100) / 100 for _, speed, _ in fleet.commands["robot1"][before:]]
    assert len(reported) == len(wanted) == pytest.approx(200, abs=2)
    return fmean(wanted), fmean(reported)


@pytest.mark.parametrize(
    "leader_speed",
    [0.0549, *slow(0.045, 0.05, 0.0511, 0.0599)],
)
def test_error_feedback_keeps_mean_speed_of_law(leader_speed: float) -> None:
    wanted, reported = means(pair(feedback=True, leader_speed=leader_speed))
    assert wanted == pytest.approx(leader_speed, rel=0.02)
    assert reported == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("leader_speed", [0.0549, *slow(0.045, 0.05, 0.0599)])
def test_without_error_feedback_robot_is_too_slow(leader_speed: float) -> None:
    wanted, reported = means(pair(feedback=False, leader_speed=leader_speed))
    assert reported < 0.95 * wanted


@pytest.mark.parametrize(("feedback", "mean"), [(True, 0.0549), (False, 0.05)])
def test_constant_speed_is_quantised_with_or_without_feedback(feedback: bool, mean: float) -> None:
    wishes = Wishes(pair(feedback=feedback), "robot1")
    reported = []
    for number in range(200):
        command = wishes.put(0.05 * number, Command(0.0549, 0.0))
        reported.append(int(command.speed * 100) / 100)
    assert fmean(reported) == pytest.approx(mean, rel=0.005)
