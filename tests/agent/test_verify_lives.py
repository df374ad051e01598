"""What agents live through is lived through again: deaths, restarts, orders, links that come and go."""

from __future__ import annotations

from typing import Any

import pytest

from agent.core import Agent
from agent.verify.core import verify
from formation.mission import Mission
from formation.mission_file import load
from formation.order import MAX_REQUEST
from formation.wire import Now
from tests.agent.missions import with_robots
from tests.agent.recorded import Looped, RecordedFleet, all_alike

SIX, PAIR = load("six_robots"), load("turtlebot3_pair")


def test_an_agent_that_was_killed_and_one_that_took_its_place_are_both_judged() -> None:
    fleet = RecordedFleet(SIX)
    fleet.run(4.0)
    fleet.kill("robot3")
    fleet.run(1.0)
    fleet.restart("robot3")
    fleet.run(4.0)
    assert all_alike(verify(SIX, fleet.record))


def test_a_new_agent_whose_beginning_is_missing_is_told_apart_from_a_late_recording() -> None:
    fleet = RecordedFleet(SIX)
    fleet.run(2.0)
    fleet.restart("robot3")
    cut = len(fleet.record)
    fleet.run(1.0)
    end = len(fleet.record)
    fleet.run(2.0)
    one = verify(SIX, fleet.record[:cut] + fleet.record[end:])["robot3"]
    assert ["another agent speaks" in stretch.reason for stretch in one.unjudged] == [True]


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


def test_orders_and_the_end_of_an_agent_are_lived_through_as_they_were() -> None:
    fleet = RecordedFleet(PAIR)
    fleet.run(2.0)
    asked = [("stop", "a"), ("release", "b"), ("hold", ""), ("release", "b"), ("stop", "b"), ("stop", "a")]
    for do, number in (*asked, ("release", ""), ("run", "")):
        fleet.ask_once("robot1", do, number)
        fleet.run(0.5)
    fleet.ask("leader", "stop")
    fleet.run(1.0)
    for name in PAIR.followers:
        fleet.halt(name)
    assert all_alike(verify(PAIR, fleet.record))


def test_a_stop_as_long_as_any_that_is_obeyed_is_lived_through_as_well() -> None:
    fleet = RecordedFleet(PAIR)
    fleet.run(2.0)
    fleet.loop("robot1").sides.request(b'{"do":"stop"}'.ljust(MAX_REQUEST), fleet.now)
    fleet.run(2.0)
    assert all_alike(verify(PAIR, fleet.record))


def test_a_link_with_the_robot_that_came_and_went_is_lived_through() -> None:
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
    agent = Agent(mission, name, readonly=True, voice="looks")
    fleet.nodes[name].core = Looped(agent, fleet.record, readonly=True)
    fleet.run(6.0)
    assert all_alike(verify(mission, fleet.record))
