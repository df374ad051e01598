"""Closed-loop scenarios: production cores of a whole fleet, a fake clock, a lossy network in memory."""

from __future__ import annotations

from dataclasses import replace
from statistics import median

import pytest

from agent.odometer import Odometer
from formation.mission import Mission
from formation.mission_file import load, parse, read, shipped
from formation.order import LEADER_LOST
from formation.topics import ODOM, POSITION
from formation.wire import Now, Sample
from tests.agent.fleet import EPOCH, Fleet, keys_of_neighbours

SIX = load("six_robots")
AT_REST = (0.0, 0.0)


def with_change(old: str, new: str, mission: str = "six_robots") -> Mission:
    text = read(mission)[0]
    assert old in text
    return parse(text.replace(old, new))


@pytest.mark.parametrize("name", shipped())
def test_the_shipped_missions_come_into_formation(name: str) -> None:
    fleet = Fleet(load(name))
    fleet.run(fleet.mission.duration)
    bounds = {"six_robots": 0.01, "turtlebot3_pair": 0.03, "two_chains": 0.12, "patrol": 0.01, "posts": 0.01}
    assert fleet.error() < bounds[name]


def test_six_robots_are_in_formation_within_eight_seconds() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    assert fleet.error() < SIX.settled


def test_the_printed_law_gets_there_too_but_takes_its_time() -> None:
    fleet = Fleet(SIX, law="paper")
    fleet.run(8.0)
    assert fleet.error() > SIX.settled
    fleet.run(82.0)
    assert fleet.error() < SIX.settled


def test_no_command_ever_exceeds_a_limit() -> None:
    fleet = Fleet(SIX, loss=0.3)
    fleet.run(10.0)
    for name in SIX.followers:
        robot = SIX.robots[name]
        assert all(
            abs(u) <= robot.max_speed and abs(w) <= robot.max_turn_rate for _, u, w in fleet.commands[name]
        )


@pytest.mark.parametrize(("loss", "typical", "worst"), [(0.1, 0.001, 0.01), (0.3, 0.02, 0.10)])
def test_lost_positions_do_not_keep_the_robots_from_formation(
    loss: float, typical: float, worst: float
) -> None:
    fleet = Fleet(SIX, loss=loss, seed=4)
    fleet.run(15.0)
    errors = []
    for _ in range(40):
        fleet.run(0.25)
        errors.append(fleet.error())
    assert median(errors) < typical
    assert max(errors) < worst


def test_robots_that_measure_displacements_themselves_come_into_formation_as_well() -> None:
    mission = with_change("rate = 20 ", 'rate = 20\nmeasurement = "local" #')
    fleet = Fleet(mission)
    fleet.run(15.0)
    assert fleet.error() < 0.001


def test_a_sensor_that_answers_after_the_odometry_of_the_same_moment_is_placed_just_as_well() -> None:
    mission = with_change("rate = 20 ", 'rate = 20\nmeasurement = "local" #')
    fleet = Fleet(mission)
    fleet.meddle = lambda sample: (
        (sample._replace(arrived=sample.arrived + 0.02),) if "/relative/" in sample.key else (sample,)
    )
    fleet.run(15.0)
    assert fleet.error() < 0.01


def test_a_dead_leader_brings_everybody_to_rest_within_its_time() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.kill("leader")
    fleet.run(LEADER_LOST + 4 * 0.05)
    assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}


def test_a_robot_that_measures_only_the_leader_rests_three_periods_after_its_death() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.kill("leader")
    fleet.run(5 * 0.05)
    assert fleet.last_command("robot2") == AT_REST
    assert "no neighbour is fresh: robot1" in fleet.status("robot2")["reason"]


def test_a_leader_that_beats_no_more_is_found_dead_although_neighbours_are_alive() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.kill("leader")
    fleet.run(LEADER_LOST + 4 * 0.05)
    # robot6 hears robot4 and robot5 all the time: only the beat tells it
    assert "beat" in fleet.status("robot6")["reason"]


def test_the_fleet_goes_on_when_the_leader_comes_back() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.kill("leader")
    fleet.run(3.0)
    fleet.revive("leader")
    fleet.run(15.0)
    assert fleet.error() < SIX.settled


def test_a_dead_neighbour_is_left_out_and_the_rest_is_followed() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.kill("robot2")
    fleet.run(5.0)
    assert fleet.status("robot3")["state"] == "run"
    assert fleet.last_command("robot3") != AT_REST


def test_a_robot_without_any_fresh_neighbour_stands_still_within_three_periods() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.kill("robot2")
    fleet.kill("robot3")
    fleet.run(3 * 0.05 + 2 * 0.05)
    assert fleet.last_command("robot4") == AT_REST
    assert "no neighbour is fresh" in fleet.status("robot4")["reason"]


def test_silent_odometry_stops_the_robot_within_three_periods() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.meddle = lambda sample: () if sample.key == ODOM.key("robot3") else (sample,)
    fleet.run(3 * 0.05 + 0.06)
    assert fleet.last_command("robot3") == AT_REST
    assert "odometry silent" in fleet.status("robot3")["reason"]


def test_a_robot_at_rest_is_told_so_again_and_again() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.meddle = lambda sample: () if sample.key == ODOM.key("robot3") else (sample,)
    fleet.run(0.5)
    before = len(fleet.commands["robot3"])
    fleet.run(1.0)
    assert 18 <= len(fleet.commands["robot3"]) - before <= 22


def test_hold_stops_all_and_run_moves_all_again() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    assert fleet.ask("robot1", "hold").ok
    fleet.run(0.5)
    assert {fleet.status(name)["reason"] for name in SIX.followers} == {"held by the leader"}
    assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}
    assert fleet.ask("robot1", "run").ok
    fleet.run(10.0)
    assert fleet.error() < SIX.settled


def test_an_operators_stop_at_one_robot_is_latched_until_released() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    assert fleet.ask("robot4", "stop").mode == "stop"
    fleet.run(0.1)
    assert fleet.last_command("robot4") == AT_REST
    refused = fleet.ask("robot4", "run")
    assert not refused.ok
    assert "release" in refused.reason
    fleet.run(1.0)
    assert fleet.status("robot4")["state"] == "stop"
    assert fleet.ask("robot4", "release").mode == "hold"
    fleet.run(2.0)
    assert fleet.last_command("robot4") == AT_REST
    assert fleet.ask("robot4", "run").ok
    fleet.run(10.0)
    assert fleet.error() < SIX.settled


def test_a_stop_of_the_leader_reaches_everybody_hop_by_hop() -> None:
    fleet = Fleet(load("two_chains"))
    fleet.run(5.0)
    fleet.ask("leader", "stop")
    fleet.run(6 * 0.06 + 0.1)
    assert {fleet.status(name)["state"] for name in fleet.mission.followers} == {"stop"}
    assert {fleet.last_command(name) for name in fleet.mission.followers} == {AT_REST}


def test_a_jump_of_the_odometry_stops_the_robot_instead_of_making_it_lurch() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    odometer = fleet.agents["robot3"]._here._source
    assert isinstance(odometer, Odometer)
    assert odometer._last is not None
    odometer._last = replace(odometer._last, position=odometer._last.position + 5.0)
    fleet.run(0.1)
    assert fleet.last_command("robot3") == AT_REST
    assert "jumped" in fleet.status("robot3")["reason"]
    fleet.run(10.0)
    assert fleet.error() < SIX.settled


def test_replayed_positions_change_no_command() -> None:
    def replaying(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != POSITION.key("robot1"):
            return (sample,)
        kept.append(sample)
        old = kept[-20] if len(kept) > 20 else None
        return (sample,) if old is None else (sample, old._replace(arrived=sample.arrived))

    honest, replayed = Fleet(SIX), Fleet(SIX)
    kept: list[Sample] = []
    replayed.meddle = replaying
    honest.run(10.0)
    replayed.run(10.0)
    assert replayed.error() == pytest.approx(honest.error(), abs=0.01)
    assert replayed.agents["robot2"].dropped[POSITION.key("robot1")] > 100


@pytest.mark.parametrize("name", shipped())
def test_an_agent_listens_to_its_odometry_its_neighbours_and_who_asks_for_its_voice_and_to_nothing_else(
    name: str,
) -> None:
    mission = load(name)
    for robot, agent in Fleet(mission).agents.items():
        assert set(agent.subscriptions) == keys_of_neighbours(mission, robot)


def test_an_agent_ends_with_zero_velocity_and_says_why() -> None:
    fleet = Fleet(SIX)
    fleet.run(4.0)
    out = fleet.agents["robot2"].halt(Now(fleet.now, EPOCH + fleet.now), "SIGTERM")
    fleet._send("robot2", out)
    assert fleet.last_command("robot2") == AT_REST
    assert fleet.status("robot2")["reason"] == "SIGTERM"
