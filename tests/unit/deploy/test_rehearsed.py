"""`rehearsed_fleet`, the fixture for users' tests."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest

from formation.deploy.testing.pytest_plugin import MakeRehearsed
from formation.deploy.testing.rehearsed import BrokenRuleError
from formation.mission.file import read


def test_fleet_settles_and_goes_on_without_killed_robot(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("six_robots", seed=1)
    assert 0.0 < fleet.run_until_settled() < 60.0
    fleet.kill("robot6")
    fleet.run(5.0)
    assert fleet.state("robot2") == "run"
    assert fleet.command("robot6") == (0.0, 0.0)
    fleet.start("robot6")
    fleet.run_until_settled(within=30.0)


def test_stop_lasts_over_agent_restart_until_released(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("six_robots", loss=0.1, faults=["robot3:frozen@4+3"])
    fleet.run(5.0)
    assert fleet.order("stop").obeyed
    fleet.run(1.0)
    places = {name: fleet.position(name) for name in fleet.mission.followers}
    fleet.kill("robot2")
    fleet.run(0.5)
    fleet.start("robot2")
    fleet.run(2.5)
    assert fleet.state("robot2") == "stop"
    assert places == {name: fleet.position(name) for name in fleet.mission.followers}
    assert fleet.order("release").obeyed
    assert fleet.order("run").obeyed
    fleet.run_until_settled()


def test_order_names_robots_that_do_not_answer(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair")
    fleet.run(3.0)
    fleet.kill("robot2")
    outcome = fleet.order("hold")
    assert outcome.missing == ["robot2"]
    assert not outcome.obeyed


def test_illegal_order_is_refused_before_it_is_sent(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("six_robots")
    with pytest.raises(ValueError, match="takes no degrees"):
        fleet.order("hold", degrees=3.0)
    assert fleet.now == 0.0


def test_unknown_robot_is_refused_by_name(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair")
    of_processes = (fleet.kill, fleet.start, fleet.freeze, fleet.thaw)
    for method in (*of_processes, fleet.state, fleet.reason, fleet.position, fleet.command):
        with pytest.raises(ValueError, match=r"'robot9': must be one of .*robot1, robot2"):
            method("robot9")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"law": "pape"}, "'pape': must be one of field, paper, proportional"),
        ({"world": "gazebo"}, "'gazebo': must be one of kinematic, mujoco"),
        ({"loss": 20.0}, "loss = 20: must be from 0 to 1$"),
        ({"delay": -1.0}, "delay = -1: must be from 0 to 60 s"),
        ({"faults": "robot1:melt@3"}, "'robot1:melt@3': melt: must be one of loss"),
    ],
)
def test_illegal_option_is_refused_by_name(
    rehearsed_fleet: MakeRehearsed, options: dict[str, Any], why: str
) -> None:
    with pytest.raises(ValueError, match=why):
        rehearsed_fleet("turtlebot3_pair", **options)


def test_cut_takes_names_of_robots_and_candidates_only(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair")
    with pytest.raises(ValueError, match="'robot9': must be one of leader, robot1, robot2"):
        fleet.cut(["robot2"], ["robot1", "robot9"])
    fleet.run(4.0)
    fleet.cut("robot2", "leader")
    fleet.run(2.0)
    assert fleet.state("robot2") == "hold"


@pytest.mark.slow
def test_rotate_order_turns_the_shape(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair")
    fleet.run_until_settled()
    assert fleet.order("rotate", degrees=90.0).obeyed
    fleet.run(0.5)
    assert fleet.error() > fleet.mission.settled
    fleet.run_until_settled()


def test_robot_stands_while_cut_off_or_frozen(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair")
    fleet.run_until_settled()
    fleet.cut(["robot2"], ["leader", "robot1"])
    fleet.run(2.0)
    assert fleet.state("robot2") == "hold"
    assert fleet.reason("robot2")
    fleet.heal()
    fleet.run_until_settled()
    fleet.freeze("robot2")
    fleet.run(2.0)
    here = fleet.position("robot2")
    fleet.run(1.0)
    assert abs(fleet.position("robot2") - here) < 1e-6
    fleet.thaw("robot2")
    fleet.run_until_settled()


@pytest.mark.slow
def test_same_calls_give_the_same_run(rehearsed_fleet: MakeRehearsed) -> None:
    def run(seed: int) -> list[complex]:
        fleet = rehearsed_fleet("turtlebot3_pair", seed=seed, loss=0.05, delay=0.02)
        fleet.run(3.0)
        fleet.order("rotate", degrees=20.0)
        fleet.run(3.0)
        return [fleet.position(name) for name in fleet.mission.followers]

    assert run(3) == run(3) != run(4)


def test_mission_can_be_given_as_text(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet(read("turtlebot3_pair")[0], law="proportional")
    assert fleet.mission.law.kind == "proportional"


@pytest.mark.parametrize("strict", [True, False])
def test_broken_rule_raises_only_if_strict(rehearsed_fleet: MakeRehearsed, *, strict: bool) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair", seed=8, strict=strict)
    fleet._fleet.engine.at(0.5, lambda: fleet._judge._tell("limits", "robot2", "9 m/s"))
    with (
        pytest.raises(BrokenRuleError, match=r"limits: 0\.50 s, robot2: 9 m/s \(seed 8\)")
        if strict
        else nullcontext()
    ):
        fleet.run(1.0)
    assert [one.rule for one in fleet.violations] == ["limits"]


def test_timeout_of_run_until_settled_reports_error_and_states(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("six_robots", seed=5)
    with pytest.raises(AssertionError, match=r"not settled within 1 s: error .* \(seed 5\); robot2: "):
        fleet.run_until_settled(within=1.0)
