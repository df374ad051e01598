"""Closed-loop scenarios: production cores of a whole fleet, a fake clock, a lossy network in memory."""

from __future__ import annotations

import itertools
from dataclasses import replace
from statistics import fmean, median
from typing import Any

import pytest

from formation.control.ramp import MAX_CHANGE_SHARE
from formation.control.unicycle import Command
from formation.mission.file import load, parse, read, shipped
from formation.mission.model import Mission
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.reasons import Code, Reason
from formation.ros2.messages import Odometry
from formation.simulation.simulate import simulate
from formation.topics import BALLOT, ODOM, POSITION, SCAN
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import altered, lost, on
from tests.support.missions import with_robots
from tests.support.restarting import Team
from tests.unit.agent.sudden import largest_command_change
from tests.unit.agent.test_scanning import least_gap
from tests.unit.formation import scenarios

SIX = load("six_robots")
LOCAL = with_robots("six_robots", measurement="local")
AT_REST = (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped())
def test_shipped_missions_come_into_formation(name: str) -> None:
    mission = load(name)
    fleet = Fleet(mission).after(min(mission.duration, 45.0))  # behind all posts
    bounds = {"two_chains": 0.12, "turtlebot3_pair": 0.03, "convoy": 0.06}
    assert fleet.error() < bounds.get(name, 0.01)


def test_six_robots_are_in_formation_within_eight_seconds() -> None:
    assert Fleet.under_way(SIX, 8.0).error() < SIX.settled


@pytest.mark.slow
def test_paper_law_settles_between_8_and_40_seconds() -> None:
    fleet = Fleet(SIX, law="paper").after(8.0)
    assert fleet.error() > SIX.settled
    fleet.run(32.0)
    assert fleet.error() < SIX.settled


@pytest.mark.slow
def test_proportional_law_forms_with_ramp_and_avoidance() -> None:
    fleet = Fleet(scenarios.exchanged(SIX), law="proportional", seed=2)
    assert least_gap(fleet, 20.0) > 0.0
    assert fleet.error() < SIX.settled
    assert largest_command_change(fleet) <= MAX_CHANGE_SHARE + 1e-9
    assert any(agent.avoiding.state.avoided for agent in fleet.agents.values())
    assert all(agent.state.integral == 0j for agent in fleet.agents.values())


@pytest.mark.slow
@pytest.mark.parametrize("law", ["field", "proportional"])
def test_simulation_and_agents_settle_at_the_same_time(law: str) -> None:
    """In the median of five starts: in one, a robot may turn or reverse the other way."""
    later = []
    for turn in (0.0, 25.0, 50.0, 75.0, 100.0):
        mission = turned(turn)
        fleet, settled = Fleet(mission, law=law, delay=(0.0, 0.0)), 0.0
        while fleet.now < 8.0:
            fleet.run(0.02)
            settled = fleet.now if fleet.error() > mission.settled else settled
        began = min(time for one in fleet.commands.values() for time, speed, _ in one if speed != 0.0)
        simulated = float(simulate(mission, law=law, horizon=20.0, step=0.05).settling_time[0])
        later.append(settled - began - simulated)
    # agents know their paths less exactly while they speed up
    assert abs(median(later)) < 0.2


def turned(degrees: float) -> Mission:
    """Six robots without noise that start with their headings turned by so much."""
    robots = {}
    for name, one in SIX.robots.items():
        start = one.start.model_copy(update={"heading_deg": one.start.heading_deg + degrees})
        robots[name] = one if name == SIX.leader else one.model_copy(update={"start": start})
    collisions = SIX.collisions.model_copy(update={"noise": 0.0})
    return SIX.model_copy(update={"robots": robots, "collisions": collisions})


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "typical", "worst"), [(0.1, 0.001, 0.01), (0.3, 0.02, 0.12)])
def test_robots_form_despite_lost_positions(loss: float, typical: float, worst: float) -> None:
    fleet = Fleet.under_way(SIX, 15.0, loss=loss, seed=4)
    assert fleet.within_limits
    errors = fleet.errors(10.0)
    assert median(errors) < typical
    assert max(errors) < worst


@pytest.mark.parametrize(("late", "bound"), [*slow((0.0, 0.001)), (0.02, 0.01)])
def test_robots_form_with_local_measurement(late: float, bound: float) -> None:
    fleet = Fleet(LOCAL)
    fleet.meddle = lambda sample: (
        (sample._replace(arrived=sample.arrived + late),) if "/relative/" in sample.key else (sample,)
    )
    fleet.run(15.0)
    assert fleet.error() < bound


def test_robots_stop_within_leader_timeout_after_leader_dies() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.kill("leader")
    fleet.run(5 * 0.05)
    assert fleet.last_command("robot2") == AT_REST  # it measures only the leader
    assert "no neighbour can be followed; silent: robot1" in str(fleet.status("robot2").reason)
    fleet.run(LEADER_TIMEOUT_SECONDS - 0.05)
    assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}
    # robot6 still receives robot4 and robot5: only the beat shows that the leader is dead
    assert fleet.status("robot6").reason.code is Code.LEADER_LOST


def test_robot_holds_only_without_any_fresh_neighbour() -> None:
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


def test_silent_odometry_stops_robot_within_quarter_second() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.meddle = lost(ODOM.key("robot3"))
    fleet.run(3 * 0.05 + 0.06)
    assert fleet.last_command("robot3") == AT_REST
    assert fleet.status("robot3").reason.code is Code.POSITION_SILENT
    before = len(fleet.commands["robot3"])
    fleet.run(1.0)
    assert 18 <= len(fleet.commands["robot3"]) - before <= 22  # zero is sent in each period


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
def test_leader_stop_reaches_all_robots_within_six_hops() -> None:
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


def test_halted_agent_sends_zero_and_reports_cause() -> None:
    fleet = Fleet(SIX).after(4.0)
    out = fleet.agents["robot2"].halt(fleet.moment, "SIGTERM")
    fleet._send("robot2", out)
    assert fleet.last_command("robot2") == AT_REST
    assert fleet.status("robot2").reason == Reason.of(Code.ENDED, cause="SIGTERM")


# Faults without an error message: the robot in doubt holds


def neighbour_speeds(fleet: Fleet) -> list[float]:
    """Speeds of robot3's neighbours by its own estimate [m/s]."""
    return [abs(one.velocity) for one in fleet.agents["robot3"].neighbours.each.values()]


def test_robot_with_too_rare_odometry_never_moves() -> None:
    fleet, newest = Fleet(SIX), [0.0]

    def thin_out(sample: Sample) -> tuple[Sample, ...]:
        if sample.arrived - newest[-1] < 1 / 6:
            return ()
        newest.append(sample.arrived)
        return (sample,)

    fleet.meddle = on(ODOM.key("robot3"), thin_out)
    fleet.run(10.0)
    assert set(fleet.commands_since("robot3", 0.0)) == {AT_REST}
    assert fleet.plant("robot3").path == 0.0


@pytest.mark.slow
def test_odometry_glitch_does_not_make_followers_lurch() -> None:
    fleet, off = Fleet(SIX).after(15.0), itertools.chain([5.0], itertools.repeat(0.0))
    fleet.meddle = altered(
        ODOM.key("robot2"), Odometry, lambda seen: replace(seen, position=seen.position + next(off))
    )
    fleet.run(2.0)
    # robot2 stands for a quarter of a second, then makes up for 4 cm of motion of its slot
    for name in SIX.followers:
        assert max(abs(speed) for speed, _ in fleet.commands_since(name, 15.0)) < 0.55


def test_repeated_position_is_not_followed() -> None:
    fleet, stuck = Fleet.under_way(SIX, 8.0), dict[str, bytes]()
    fleet.meddle = on(  # the orders continue
        POSITION.key("robot1"), lambda one: (one._replace(payload=stuck.setdefault("", one.payload)),)
    )
    fleet.run(3.0)
    assert set(fleet.commands_since("robot2", 8.3)) == {AT_REST}
    assert fleet.status("robot2").reason.code is Code.NO_NEIGHBOUR
    assert not fleet.status("robot2").reason.values["unavailable"]


@pytest.mark.slow
def test_sensor_faster_than_odometry_does_not_inflate_velocity() -> None:
    fleet, count = Fleet(LOCAL), itertools.count()
    fleet.meddle = on(ODOM.key("robot3"), lambda sample: (sample,) if next(count) % 2 else ())
    fleet.run(15.0)
    assert neighbour_speeds(fleet) == pytest.approx([0.2, 0.2], abs=0.01)
    assert fleet.error() < 0.001


@pytest.mark.slow
def test_measurements_during_hold_do_not_inflate_velocity_afterwards() -> None:
    fleet = Fleet(LOCAL).after(10.0)
    fleet.ask("robot3", "hold")
    fleet.run(10.0)
    fleet.ask("robot3", "run")
    fleet.run(0.15)
    assert fleet.status("robot3").state == "run"
    assert neighbour_speeds(fleet) == pytest.approx([0.2, 0.2], abs=0.01)


@pytest.mark.slow
def test_slow_robot_follows_fast_neighbour_by_sensor() -> None:
    text = read("six_robots")[0].replace("rate = 20 ", "rate = 50 ")
    mission = parse(text.replace("[robots.robot3]", '[robots.robot3]\nrate = 10\nmeasurement = "local"'))
    fleet = Fleet(mission).after(12.0)
    assert AT_REST not in fleet.commands_since("robot3", 2.0)
    assert fleet.error() < mission.settled


def test_hold_and_stop_take_effect_at_next_step() -> None:
    fleet = Fleet.under_way(SIX, 8.0)

    def step() -> None:
        fleet._send("robot3", fleet.agents["robot3"].step(fleet.moment, []))

    fleet.ask("robot3", "hold")
    step()
    assert fleet.last_command("robot3") == AT_REST
    fleet.ask("robot3", "run")
    rested = fleet.now
    while fleet.last_command("robot3") == AT_REST:
        fleet.run(0.001)
    assert fleet.now - rested < 0.05
    fleet.ask("robot3", "stop")
    step()
    assert fleet.last_command("robot3") == AT_REST


# A robot that truncates commands to hundredths


def means(step: float, leader_speed: float) -> tuple[float, float]:
    """Mean forward speed over 10 s in formation: as the law wants it, and as the robot uses it [m/s].

    In the mission commands have this `step`; the robot truncates them to hundredths in any case.
    """
    mission = with_robots("turtlebot3_pair", speed_step=step, turn_rate_step=step)
    (leg,) = mission.route
    mission = mission.model_copy(update={"route": (leg.model_copy(update={"speed": leader_speed}),)})
    fleet, wanted = Fleet(mission).after(15.0), list[float]()
    agent, before = fleet.agents["robot1"], len(fleet.commands["robot1"])
    law = agent._params.law

    def recorded(*arguments: Any) -> tuple[Command, Any]:
        command, integral = law(*arguments)
        wanted.append(float(command.speed))
        return command, integral

    agent._params = agent._params._replace(law=recorded)
    fleet.run(10.0)
    reported = [int(speed * 100) / 100 for _, speed, _ in fleet.commands["robot1"][before:]]
    assert len(reported) == len(wanted) == pytest.approx(200, abs=2)
    return fmean(wanted), fmean(reported)


@pytest.mark.parametrize("leader_speed", [0.0549, *slow(0.045, 0.05, 0.0511, 0.0599)])
def test_error_feedback_keeps_mean_speed_of_law(leader_speed: float) -> None:
    wanted, reported = means(0.01, leader_speed)
    assert wanted == pytest.approx(leader_speed, rel=0.02)
    assert reported == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("leader_speed", [0.0549, *slow(0.045, 0.05, 0.0599)])
def test_robot_without_error_feedback_is_too_slow(leader_speed: float) -> None:
    wanted, reported = means(0.0, leader_speed)
    assert reported < 0.95 * wanted


# Copies of fleets, from which other tests start


def events(fleet: Fleet) -> tuple[object, ...]:
    """Kill, stop and restart parts of a fleet; return its commands, messages and leader terms."""
    name = fleet.mission.followers[-1]
    fleet.kill(name)
    fleet.run(0.5)
    fleet.ask("leader", "stop")
    fleet.run(0.5)
    fleet.restart(name)
    fleet.set_going(name)
    fleet.set_going("leader")
    fleet.run(2.0)
    return dict(fleet.commands), [fleet.message(one) for one in fleet.agents], fleet.leader_terms


@pytest.mark.slow
def test_copied_fleet_behaves_like_new_fleet() -> None:
    for kind, name in ((Team, "turtlebot3_pair"), (Fleet, "patrol")):
        mission = load(name)
        new = events(kind(mission, loss=0.1).after(2.0))
        assert [events(kind.under_way(mission, 2.0, loss=0.1)) for _ in range(2)] == [new] * 2
