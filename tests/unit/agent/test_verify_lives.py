"""What agents live through is lived through again: deaths, restarts, orders, links that come and go."""

from __future__ import annotations

from typing import Any

import pytest

from formation.agent.core import Agent
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.order import MAX_REQUEST_BYTES
from formation.wire import Now
from tests.support.missions import with_robots
from tests.support.recorded import Looped, RecordedFleet, all_alike, verify

SIX, PAIR = load("six_robots"), load("turtlebot3_pair")


@pytest.mark.slow
def test_killed_agent_and_its_successor_are_both_judged() -> None:
    fleet = RecordedFleet(SIX)
    fleet.run(4.0)
    fleet.kill("robot3")
    fleet.run(1.0)
    fleet.restart("robot3")
    fleet.run(4.0)
    assert all_alike(verify(SIX, fleet.record))


def test_new_agent_with_missing_beginning_is_distinguished() -> None:
    fleet = RecordedFleet(SIX)
    fleet.run(2.0)
    fleet.restart("robot3")
    cut = len(fleet.record)
    fleet.run(1.0)
    end = len(fleet.record)
    fleet.run(2.0)
    one = verify(SIX, fleet.record[:cut] + fleet.record[end:])["robot3"]
    assert ["another agent publishes" in stretch.reason for stretch in one.unjudged] == [True]


def test_two_agents_that_speak_for_one_robot_are_both_judged() -> None:
    fleet = RecordedFleet(SIX)
    fleet.run(2.0)
    other = Looped(fleet.new_agent("robot3"), fleet.record)
    fleet.meddle = lambda sample: (sample,)
    step = fleet.loop("robot3").step

    def both(now: Now, inbox: Any) -> Any:
        other.step(now, inbox)
        return step(now, inbox)

    fleet.loop("robot3").step = both  # type: ignore[method-assign]
    fleet.run(3.0)
    one = verify(SIX, fleet.record)["robot3"]
    assert one.commands > 150
    assert one.exact == one.commands


def test_operator_requests_and_halt_are_reproduced() -> None:
    fleet = RecordedFleet(PAIR)
    fleet.run(2.0)
    requested = [
        ("stop", "a"),
        ("release", "b"),
        ("hold", ""),
        ("release", "b"),
        ("stop", "b"),
        ("stop", "a"),
    ]
    for do, number in (*requested, ("release", ""), ("run", "")):
        fleet.ask_once("robot1", do, number)
        fleet.run(0.5)
    fleet.ask("leader", "stop")
    fleet.run(1.0)
    for name in PAIR.followers:
        fleet.halt(name)
    assert all_alike(verify(PAIR, fleet.record))


def test_longest_obeyed_stop_is_reproduced() -> None:
    fleet = RecordedFleet(PAIR)
    fleet.run(2.0)
    fleet.loop("robot1").sides.request(b'{"do":"stop"}'.ljust(MAX_REQUEST_BYTES), fleet.now)
    fleet.run(2.0)
    assert all_alike(verify(PAIR, fleet.record))


@pytest.mark.slow
def test_robot_link_outage_is_reproduced() -> None:
    fleet = RecordedFleet(SIX)
    fleet.run(2.0)
    fleet.loop("robot3").robot.connected = False
    fleet.run(1.0)
    fleet.loop("robot3").robot.connected = True
    fleet.run(2.0)
    assert all_alike(verify(SIX, fleet.record))


@pytest.mark.parametrize("mission", [SIX, with_robots("turtlebot3_pair", localisation="external")])
def test_an_agent_that_moves_nothing_is_verified_as_well(mission: Mission) -> None:
    fleet = RecordedFleet(mission)
    name = mission.followers[0]
    agent = Agent(mission, name, readonly=True, publisher_id="looks")
    fleet.nodes[name].core = Looped(agent, fleet.record)
    fleet.run(6.0)
    assert all_alike(verify(mission, fleet.record))
