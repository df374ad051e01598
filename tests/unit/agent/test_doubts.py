"""Closed-loop scenarios of things that go wrong quietly: in every one the robot in doubt stands still."""

from __future__ import annotations

from dataclasses import replace

import pytest

from formation.mission.file import load, parse, read
from formation.protocol.reasons import Code
from formation.ros2.messages import Odometry
from formation.topics import ODOM, POSITION
from formation.wire import Sample
from tests.support.fleet import Fleet
from tests.support.meddling import altered, on
from tests.support.missions import with_robots

SIX = load("six_robots")
LOCAL = with_robots("six_robots", measurement="local")
AT_REST = (0.0, 0.0)


@pytest.mark.slow
def test_an_agent_that_restarts_on_the_way_takes_its_place() -> None:
    fleet = Fleet(SIX).after(2.0)
    fleet.restart("robot4")
    fleet.run(13.0)
    assert fleet.error() < SIX.settled


def test_too_rare_odometry_never_moves_robot() -> None:
    fleet = Fleet(SIX)
    newest = [0.0]

    def thin_out(sample: Sample) -> tuple[Sample, ...]:
        if sample.key == ODOM.key("robot3"):
            if sample.arrived - newest[0] < 1 / 6:
                return ()
            newest[0] = sample.arrived
        return (sample,)

    fleet.meddle = thin_out
    fleet.run(10.0)
    assert set(fleet.commands_since("robot3", 0.0)) == {AT_REST}
    assert fleet.plant("robot3").path == 0.0


@pytest.mark.slow
def test_odometry_glitch_does_not_make_followers_lurch() -> None:
    fleet = Fleet(SIX).after(15.0)
    left = [5.0]

    def glitch(seen: Odometry) -> Odometry:
        return replace(seen, position=seen.position + left.pop()) if left else seen

    fleet.meddle = altered(ODOM.key("robot2"), Odometry, glitch)
    fleet.run(2.0)
    # robot2 stands for a quarter of a second, and closes the 4 cm that its slot moves meanwhile
    for name in SIX.followers:
        assert max(abs(speed) for speed, _ in fleet.commands_since(name, 15.0)) < 0.55


def test_a_position_said_again_and_again_is_not_followed() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    stuck: list[Sample] = []

    def repeat(sample: Sample) -> tuple[Sample]:
        stuck.append(sample)
        return (sample._replace(payload=stuck[0].payload),)  # the order goes on

    fleet.meddle = on(POSITION.key("robot1"), repeat)
    fleet.run(3.0)
    assert set(fleet.commands_since("robot2", 8.3)) == {AT_REST}
    assert fleet.status("robot2").reason.code is Code.NO_NEIGHBOUR
    assert not fleet.status("robot2").reason.values["unavailable"]


@pytest.mark.slow
def test_sensor_faster_than_odometry_does_not_inflate_velocity() -> None:
    fleet, count = Fleet(LOCAL), [0]

    def halve(sample: Sample) -> tuple[Sample, ...]:
        count[0] += sample.key == ODOM.key("robot3")
        return () if sample.key == ODOM.key("robot3") and count[0] % 2 else (sample,)

    fleet.meddle = halve
    fleet.run(15.0)
    for one in fleet.agents["robot3"].neighbours.each.values():
        assert abs(one.velocity) == pytest.approx(0.2, abs=0.01)
    assert fleet.error() < 0.001


@pytest.mark.slow
def test_measurements_during_hold_do_not_inflate_velocity_afterwards() -> None:
    fleet = Fleet(LOCAL).after(10.0)
    fleet.ask("robot3", "hold")
    fleet.run(10.0)
    fleet.ask("robot3", "run")
    fleet.run(0.15)
    assert fleet.status("robot3").state == "run"
    for one in fleet.agents["robot3"].neighbours.each.values():
        assert abs(one.velocity) == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
def test_slow_robot_follows_fast_neighbour_by_sensor() -> None:
    text = read("six_robots")[0].replace("rate = 20 ", "rate = 50 ")
    mission = parse(text.replace("[robots.robot3]", '[robots.robot3]\nrate = 10\nmeasurement = "local"'))
    fleet = Fleet(mission).after(12.0)
    assert AT_REST not in fleet.commands_since("robot3", 2.0)
    assert fleet.error() < mission.settled


def test_a_stop_takes_hold_at_once_even_right_after_a_rest() -> None:
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
