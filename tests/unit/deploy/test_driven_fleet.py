"""Fleets behind a leader that is driven by hand, on the virtual clock."""

from __future__ import annotations

import pytest

from formation.control.unicycle import AT_REST
from formation.deploy.testing.pytest_plugin import MakeRehearsed
from formation.deploy.testing.rehearsed import RehearsedFleet
from formation.mission.file import read
from formation.mission.route import Waypoints
from tests.campaigns.defects.plan import MISSIONS
from tests.campaigns.driving.__main__ import FAILURES
from tests.support.examples import slow
from tests.support.missions import with_keys

STAND_SECONDS = 0.5
"""Time after the driver's last input, or a failure, within which all robots stand [s]."""
SOME = "driver cut off", "leader dies"
"""Failures that are tried by default."""


def at_rest(fleet: RehearsedFleet) -> bool:
    return {fleet.command(name) for name in fleet.mission.followers} == {AT_REST}


def test_robots_follow_a_driven_leader(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("convoy")
    fleet.drive(0.1, seconds=9.0)
    fleet.drive(0.1, 0.1, seconds=4.0)
    fleet.drive(0.1, seconds=5.0)
    assert fleet.error() < 0.1
    assert fleet.position("robot1").real > 1.0


@pytest.mark.parametrize("forward", [0.12, *slow(-0.08)])
def test_all_robots_stand_soon_after_driver_lets_go(rehearsed_fleet: MakeRehearsed, forward: float) -> None:
    fleet = rehearsed_fleet("convoy", loss=0.05, delay=0.01)
    fleet.drive(forward, 0.05, seconds=4.0)
    fleet.run(STAND_SECONDS)
    assert at_rest(fleet)
    places = {name: fleet.position(name) for name in fleet.mission.followers}
    fleet.run(8.0 if forward > 0.0 else 5.0)
    assert all(abs(fleet.position(name) - place) < 0.005 for name, place in places.items())


@pytest.mark.slow
def test_robots_behind_a_slower_link_stand_soon_after_driver_lets_go(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("convoy", faults=["robot1:delay=0.3@4"])
    fleet.run(1.0)
    fleet.drive(0.15, seconds=6.0)
    fleet.run(STAND_SECONDS)
    assert at_rest(fleet)


def test_leader_is_not_driven_while_orders_are_late(rehearsed_fleet: MakeRehearsed) -> None:
    """The delay is the same from the start, so no robot can see it: it would stand 2 s after release."""
    fleet = rehearsed_fleet("convoy", faults=["robot1:delay=2@0"], strict=False)
    fleet.run(8.0)
    fleet.drive(0.15, seconds=3.0)
    plan = fleet._fleet.leading.plan
    assert plan.where() == 0j
    assert not plan.driven


@pytest.mark.parametrize("seed", [0, *slow(1)])
@pytest.mark.parametrize("failure", [*SOME, *slow(*(one for one in FAILURES if one not in SOME))])
def test_all_robots_stand_soon_after_a_failure(
    rehearsed_fleet: MakeRehearsed, failure: str, seed: int
) -> None:
    fleet = rehearsed_fleet("convoy", seed=seed)
    fleet.run(2.0)
    fleet._judge.expect("hold")
    fleet._operator.drive(0.12, 0.1, 60.0)
    fleet.run(3.0 + 0.013 * seed)
    assert AT_REST not in {fleet.command(name) for name in fleet.mission.followers}
    FAILURES[failure](fleet)
    fleet.run(STAND_SECONDS)
    assert at_rest(fleet)


def test_robots_follow_after_goals_at_high_rate(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("convoy")
    fleet.run(2.0)
    for number in range(100):
        leg = Waypoints(waypoints=((2.0, 0.002 * number),), speed=0.1)
        fleet._operator.order("route", legs=(leg,))
        fleet.run(0.005)
    fleet.run(3.0)
    assert {fleet.state(name) for name in fleet.mission.followers} == {"run"}
    place = fleet.position("robot4")
    fleet.drive(0.1, seconds=4.0)
    assert abs(fleet.position("robot4") - place) > 0.2


def test_leader_stays_with_dead_robot_in_its_place(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet("convoy")
    fleet.drive(0.15, seconds=4.0)
    fleet.kill("robot1")
    fleet.drive(0.15, seconds=6.0)
    bound = fleet.mission.cohesion
    assert bound is not None
    assert abs(fleet._fleet.leading.plan.where() - fleet.position("robot1")) < bound.error


@pytest.mark.slow
def test_agent_without_state_joins_driven_fleet_with_measured_heading(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet(with_keys(read("six_robots")[0], localisation="odometry"), strict=False)
    fleet.drive(0.15, 0.3, seconds=7.0)
    fleet.kill("robot3")
    fleet._fleet.disks["robot3"].files.clear()
    fleet.run(1.0)
    fleet.start("robot3")
    fleet.run(1.5)
    here = fleet._fleet.agents["robot3"][0].here
    assert abs(here.heading - here.state.measured) < 0.1


@pytest.mark.slow
def test_team_holds_until_the_next_leader_is_driven(rehearsed_fleet: MakeRehearsed) -> None:
    fleet = rehearsed_fleet(MISSIONS / "trio.toml")
    fleet.drive(0.1, seconds=4.0)
    fleet.drive(0.1, seconds=1.0)
    fleet.kill(fleet.leader)
    fleet.run(4.0)
    assert fleet.leader == "deputy"
    assert at_rest(fleet)
    fleet.drive(0.1, seconds=5.0)
    assert {fleet.state(name) for name in fleet.mission.followers} == {"run"}


@pytest.mark.slow
def test_pauses_in_driving_restore_no_trust_in_frozen_sensor(rehearsed_fleet: MakeRehearsed) -> None:
    text = with_keys(read("turtlebot3_pair")[0], measurement="local")
    fleet = rehearsed_fleet(text, faults=["robot2:relative_frozen@8"], strict=False)
    fleet.run(2.0)
    fleet.drive(0.1, seconds=8.0)
    driven, place = 0.0, fleet.position("robot2")
    for number in range(75):
        if number % 7 == 5:  # lets go for a moment every 1.4 s
            fleet.run(0.2)
        else:
            fleet.drive(0.1, seconds=0.2)
        driven, place = driven + abs(fleet.position("robot2") - place), fleet.position("robot2")
    assert driven < 0.1
