"""Closed-loop scenarios of messages that come later and later, and of own positions that come late."""

from __future__ import annotations

import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.lateness import MAX_BEAT_LATENESS
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState
from tests.campaigns.reliability.late import BOUNDED, FARTHEST, LINKS, SENSORS, dead_leader, late_sensor
from tests.support.examples import slow
from tests.support.fleet import Fleet, Link
from tests.support.missions import with_robots

SIX = load("six_robots")
EXTERNAL = with_robots("six_robots", localisation="external")
PAIR = load("turtlebot3_pair")
PROMPT = (0.0005, 0.002)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "link", "seed"),
    [*((SIX, link, 1) for link in SENSORS.values()), (EXTERNAL, Link(0.0, (1.0, 1.0)), 2)],
    ids=[*SENSORS, "external"],
)
def test_robot_holds_while_own_positions_are_late(mission: Mission, link: Link, seed: int) -> None:
    tried = late_sensor(mission, "robot3", link, seed=seed)
    assert tried.held
    assert tried.driven < FARTHEST
    assert tried.well


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.1, 0.15])
def test_own_positions_below_the_limit_keep_formation(late: float) -> None:
    fleet = Fleet(SIX)
    for name in SIX.followers:
        fleet.sensors[name] = Link(0.0, (late, late))
    fleet.run(20.0)
    assert fleet.error() < SIX.settled
    assert fleet.states == {AgentState.RUN}


@pytest.mark.parametrize("words", ["links later by 1 s/s", *slow("links of 3 kB/s")])
def test_robots_hold_soon_after_the_leader_dies_behind_slow_links(words: str) -> None:
    assert dead_leader(PAIR, LINKS[words], seed=1) <= BOUNDED


def test_hold_takes_effect_soon_behind_links_that_slow_down() -> None:
    fleet = Fleet.under_way(PAIR, 8.0)
    fleet.links["leader", "robot2"] = Link(0.0, PROMPT, growth=1.0, since=fleet.now)
    fleet.run(3.0)
    fleet.ask("robot1", "hold")
    fleet.run(LEADER_TIMEOUT_SECONDS + MAX_BEAT_LATENESS)
    assert fleet.agents["robot2"].decision.state is AgentState.HOLD


def test_robot_follows_again_when_links_are_well() -> None:
    fleet = Fleet.under_way(PAIR, 8.0)
    fleet.links["leader", "robot2"] = Link(0.0, PROMPT, growth=1.0, since=fleet.now)
    fleet.run(5.0)
    assert fleet.agents["robot2"].decision.state == "hold"
    fleet.heal()
    fleet.run(1.0)
    assert fleet.agents["robot2"].decision.state is AgentState.RUN


def test_thawed_leader_is_followed_at_once() -> None:
    fleet = Fleet.under_way(PAIR, 8.0)
    fleet.freeze("leader")
    fleet.run(5.0)
    fleet.thaw("leader")
    fleet.run(0.5)
    assert fleet.agents["robot2"].decision.state is AgentState.RUN


@pytest.mark.slow
def test_uneven_links_never_hold_for_good() -> None:
    fleet = Fleet(SIX, delay=(0.1, 0.3), seed=3).after(15.0)
    held: list[Reason] = []
    for _ in fleet.every(0.1, 10.0):
        agents = fleet.agents.values()
        held += [one.decision.reason for one in agents if one.decision.state is AgentState.HOLD]
    assert len(held) < 10  # samples that overtake each other leave gaps of over three periods
    assert {reason.code for reason in held} <= {Code.NO_NEIGHBOUR}
    assert not any(reason.values["unavailable"] for reason in held)
