"""Closed-loop scenarios: production cores of a whole fleet, a fake clock, a lossy network in memory."""

from __future__ import annotations

from statistics import median

import pytest

from formation.control.ramp import MAX_CHANGE_SHARE
from formation.mission.file import load, shipped
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.reasons import Code, Reason
from formation.simulation.simulate import simulate
from formation.topics import BALLOT, ODOM, POSITION, SCAN
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import lost
from tests.support.missions import with_robots
from tests.unit.agent.sudden import most_sudden
from tests.unit.agent.test_scanning import room
from tests.unit.formation import scenarios

SIX = load("six_robots")
AT_REST = (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped())
def test_the_shipped_missions_come_into_formation(name: str) -> None:
    mission = load(name)
    fleet = Fleet(mission).after(mission.duration)
    bounds = {"two_chains": 0.12, "turtlebot3_pair": 0.03, "convoy": 0.06}
    assert fleet.error() < bounds.get(name, 0.01)


def test_six_robots_are_in_formation_within_eight_seconds() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    assert fleet.error() < SIX.settled


@pytest.mark.slow
def test_the_printed_law_gets_there_too_but_takes_its_time() -> None:
    fleet = Fleet(SIX, law="paper").after(8.0)
    assert fleet.error() > SIX.settled
    fleet.run(82.0)
    assert fleet.error() < SIX.settled


def test_proportional_law_ramps_avoids_and_gets_there() -> None:
    fleet = Fleet(scenarios.exchanged(SIX), law="proportional", seed=2)
    assert room(fleet, 20.0) > 0.0
    assert fleet.error() < SIX.settled
    assert most_sudden(fleet) <= MAX_CHANGE_SHARE + 1e-9
    assert any(agent.avoiding.state.avoided for agent in fleet.agents.values())
    assert all(agent.state.integral == 0j for agent in fleet.agents.values())


@pytest.mark.slow
@pytest.mark.parametrize("law", ["field", "proportional"])
def test_simulation_settles_when_agents_do(law: str) -> None:
    mission = SIX.model_copy(update={"collisions": SIX.collisions.model_copy(update={"noise": 0.0})})
    fleet, settled = Fleet(mission, law=law, delay=(0.0, 0.0)), 0.0
    while fleet.now < 8.0:
        fleet.run(0.02)
        settled = fleet.now if fleet.error() > mission.settled else settled
    began = min(time for one in fleet.commands.values() for time, speed, _ in one if speed != 0.0)
    simulated = float(simulate(mission, law=law, horizon=20.0, step=0.05).settling_time[0])
    print(law, settled - began, simulated)
    # agents know their paths less exactly while they speed up
    assert simulated == pytest.approx(settled - began, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "typical", "worst"), [(0.1, 0.001, 0.01), (0.3, 0.02, 0.12)])
def test_lost_positions_do_not_keep_the_robots_from_formation(
    loss: float, typical: float, worst: float
) -> None:
    fleet = Fleet.under_way(SIX, 15.0, loss=loss, seed=4)
    assert fleet.within_limits
    errors = fleet.errors(10.0)
    assert median(errors) < typical
    assert max(errors) < worst


@pytest.mark.parametrize(("late", "bound"), [*slow((0.0, 0.001)), (0.02, 0.01)])
def test_robots_that_measure_displacements_themselves_form(late: float, bound: float) -> None:
    fleet = Fleet(with_robots("six_robots", measurement="local"))
    fleet.meddle = lambda sample: (
        (sample._replace(arrived=sample.arrived + late),) if "/relative/" in sample.key else (sample,)
    )
    fleet.run(15.0)
    assert fleet.error() < bound


def test_dead_leader_stops_all_robots_in_time() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.kill("leader")
    fleet.run(5 * 0.05)
    assert fleet.last_command("robot2") == AT_REST  # it measures only the leader
    assert "no neighbour can be followed; silent: robot1" in str(fleet.status("robot2").reason)
    fleet.run(LEADER_TIMEOUT_SECONDS - 0.05)
    assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}
    # robot6 receives robot4 and robot5 all the time: only the beat tells it
    assert fleet.status("robot6").reason.code is Code.LEADER_LOST


def test_a_robot_without_any_fresh_neighbour_stands_still_within_three_periods() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.kill("robot2")
    fleet.run(5.0)
    assert fleet.status("robot3").state == fleet.status("robot4").state == "run"
    assert fleet.last_command("robot3") != AT_REST != fleet.last_command("robot4")
    fleet.kill("robot3")
    fleet.run(3 * 0.05 + 2 * 0.05)
    assert fleet.last_command("robot4") == AT_REST
    assert fleet.status("robot4").reason.code is Code.NO_NEIGHBOUR
    assert not fleet.status("robot4").reason.values["unavailable"]


def test_silent_odometry_stops_the_robot_within_three_periods() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.meddle = lost(ODOM.key("robot3"))
    fleet.run(3 * 0.05 + 0.06)
    assert fleet.last_command("robot3") == AT_REST
    assert fleet.status("robot3").reason.code is Code.POSITION_SILENT
    before = len(fleet.commands["robot3"])
    fleet.run(1.0)
    assert 18 <= len(fleet.commands["robot3"]) - before <= 22  # it is told so again and again


def test_hold_stops_all_and_run_moves_all_again() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    assert fleet.ask("robot1", "hold").ok
    fleet.run(0.5)
    assert {fleet.status(name).reason.code for name in SIX.followers} == {Code.HELD_BY_LEADER}
    assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}
    assert fleet.ask("robot1", "run").ok
    fleet.run(6.0)
    assert fleet.error() < SIX.settled


@pytest.mark.slow
def test_leader_stop_reaches_all_robots_hop_by_hop() -> None:
    fleet = Fleet(load("two_chains")).after(5.0)
    fleet.ask("leader", "stop")
    fleet.run(6 * 0.06 + 0.1)
    assert {fleet.status(name).state for name in fleet.mission.followers} == {"stop"}
    assert {fleet.last_command(name) for name in fleet.mission.followers} == {AT_REST}


@pytest.mark.parametrize("name", shipped())
def test_agent_subscribes_only_to_needed_keys(name: str) -> None:
    mission = load(name)
    for robot, agent in Fleet(mission).agents.items():
        scan = {SCAN.key(robot)} if mission.robots[robot].scanner != "none" else set()
        ballots = {BALLOT.key(one) for one in mission.candidates} if mission.standbys else set()
        others = {POSITION.key(other) for other in mission.received_by(robot)}
        assert set(agent.subscriptions) == {ODOM.key(robot)} | others | ballots | scan


def test_an_agent_ends_with_zero_velocity_and_says_why() -> None:
    fleet = Fleet(SIX).after(4.0)
    out = fleet.agents["robot2"].halt(fleet.moment, "SIGTERM")
    fleet._send("robot2", out)
    assert fleet.last_command("robot2") == AT_REST
    assert fleet.status("robot2").reason == Reason.of(Code.ENDED, cause="SIGTERM")
