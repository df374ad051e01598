"""A robot that cuts commands to hundredths drives, on average, exactly as the law wants it to."""

from __future__ import annotations

from statistics import fmean
from typing import Any

import pytest

from agent.commander import Commander
from formation.mission import Mission
from formation.unicycle import Command
from formation.wire import Now
from tests.agent.fleet import Fleet
from tests.agent.missions import with_robots


def pair(*, feedback: bool, leader_speed: float = 0.05) -> Mission:
    step = 0.01 if feedback else 0.0
    mission = with_robots("turtlebot3_pair", speed_step=step, turn_rate_step=step)
    (leg,) = mission.route
    return mission.model_copy(update={"route": (leg.model_copy(update={"speed": leader_speed}),)})


class Wanted:
    """Overhears what the law wants of one robot, before anything is made of it."""

    def __init__(self, fleet: Fleet, name: str) -> None:
        self.commands: list[Command] = []
        agent = fleet.agents[name]
        law = agent._law

        def overheard(*arguments: Any) -> tuple[Command, Any]:
            command, integral = law(*arguments)
            self.commands.append(Command(float(command.speed), float(command.turn_rate)))
            return command, integral

        agent._law = overheard


def means(mission: Mission) -> tuple[float, float]:
    """Mean forward speed over 10 s in formation: wanted by the law, and as the robot takes it [m/s]."""
    fleet = Fleet(mission)
    fleet.run(20.0)
    wanted, before = Wanted(fleet, "robot1"), len(fleet.commands["robot1"])
    fleet.run(10.0)
    told = [int(speed * 100) / 100 for _, speed, _ in fleet.commands["robot1"][before:]]
    assert len(told) == len(wanted.commands) == pytest.approx(200, abs=2)
    return fmean(command.speed for command in wanted.commands), fmean(told)


@pytest.mark.parametrize("leader_speed", [0.045, 0.05, 0.0511, 0.0549, 0.0599])
def test_with_error_feedback_the_mean_speed_is_the_laws_to_half_a_percent(leader_speed: float) -> None:
    wanted, told = means(pair(feedback=True, leader_speed=leader_speed))
    assert wanted == pytest.approx(leader_speed, rel=0.02)
    assert told == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("leader_speed", [0.045, 0.05, 0.0549, 0.0599])
def test_without_it_the_robot_is_slower_than_the_law_wants_it_to_be(leader_speed: float) -> None:
    wanted, told = means(pair(feedback=False, leader_speed=leader_speed))
    assert told < 0.95 * wanted


@pytest.mark.parametrize(("feedback", "mean"), [(True, 0.0549), (False, 0.05)])
def test_of_a_steady_wish_a_robot_that_cuts_commands_drives_all_or_only_whole_steps(
    feedback: bool, mean: float
) -> None:
    commander = Commander(pair(feedback=feedback), "robot1")
    told = []
    for number in range(200):
        commander.say(Now(0.05 * number, 1.7e9), Command(0.0549, 0.0))
        told.append(int(commander.newest.speed * 100) / 100)
    assert fmean(told) == pytest.approx(mean, rel=0.005)
