"""Takeover by standbys: which candidate leads, from which position, and what the robots do meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.robot import Start
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet, Link
from tests.unit.agent.sudden import largest_command_change


def in_place(mission: Mission) -> Mission:
    """The mission with its robots at their slots."""
    robots = dict(mission.robots)
    for name in mission.followers:
        slot = mission.slot(name) - robots[name].control_point_offset
        robots[name] = robots[name].model_copy(update={"start": Start(x=slot.real, y=slot.imag)})
    return mission.model_copy(update={"robots": robots})


PATROL = in_place(load("patrol"))
SPEED = 0.2
"""Speed of the leader on its route [m/s]."""
PERIOD = 0.05


def leader_names(fleet: Fleet) -> list[str]:
    """Names of the candidates that led, in order."""
    return [leader_term.name for leader_term in fleet.leader_terms]


def driving(seed: int = 1) -> Fleet:
    """A fleet in formation behind the leader's own process."""
    fleet = Fleet.under_way(PATROL, 4.0, seed=seed)
    assert leader_names(fleet) == ["leader"]
    assert fleet.error() < 0.1
    return fleet


@pytest.fixture
def fleet() -> Iterator[Fleet]:
    fleet = driving()
    yield fleet
    assert fleet.most_at_once == 1
    assert fleet.within_limits


@pytest.mark.parametrize("seed", [1, *slow(0, 2, 3)])
def test_standby_continues_from_position_of_dead_leader(seed: int) -> None:
    fleet = driving(seed=seed)
    last, time, died = fleet.leader.where(fleet.now), fleet.leader.route_time, fleet.now
    fleet.kill("leader")
    fleet.run(PATROL.takeover + 2 * PERIOD)
    assert leader_names(fleet) == ["leader", "deputy"]
    deputy, since = fleet.candidates["deputy"], fleet.leader_terms[-1].since
    assert since - died <= PATROL.takeover
    moment = since if fleet.now - since < PERIOD else fleet.now
    assert abs(deputy.where(moment) - last) <= 0.02 + SPEED * (fleet.now - died)
    assert abs(deputy.route_time - time) <= fleet.now - died + 2 * PERIOD
    fleet.run(5.0)
    assert fleet.error() < 0.1
    assert largest_command_change(fleet, died, rests=True) <= 0.5
    assert {fleet.status(name).state for name in fleet.agents} == {"run"}
    assert fleet.most_at_once == 1


def test_orders_stay_in_force_under_next_leader(fleet: Fleet) -> None:
    fleet.order_shape("line")
    fleet.run(0.5)
    fleet.ask("leader", "hold")
    fleet.run(0.5)
    fleet.kill("leader")
    fleet.run(2.0)
    deputy = fleet.candidates["deputy"]
    assert (deputy.leads, deputy.plan.shape_transition.ordered.shape, deputy.mode) == (True, "line", "hold")
    assert fleet.ask("deputy", "run").mode == "run"
    fleet.run(8.0)
    assert fleet.error() < 0.1


def test_stop_stays_in_force_after_leader_dies(fleet: Fleet) -> None:
    fleet.ask("leader", "stop")
    fleet.run(0.3)
    fleet.kill("leader")
    fleet.run(3.0)
    assert fleet.candidates["deputy"].leads
    assert {fleet.status(name).state for name in fleet.agents} == {"stop"}


def test_restarted_leader_leads_only_after_deputy_dies(fleet: Fleet) -> None:
    fleet.kill("leader")
    fleet.run(2.0)
    fleet.restart("leader")
    fleet.run(3.0)
    assert leader_names(fleet) == ["leader", "deputy"]
    assert fleet.leaders == ["deputy"]
    assert not fleet.leader.leads
    fleet.kill("deputy")
    fleet.run(1.5)
    assert fleet.leaders == ["leader"]


def test_thawed_leader_publishes_no_order(fleet: Fleet) -> None:
    fleet.freeze("leader")
    fleet.run(3.0)
    assert fleet.leaders == ["deputy"]
    result = fleet.leader.beat
    fleet.thaw("leader")
    fleet.run(2.0)
    assert fleet.leader.beat == result
    assert fleet.leaders == ["deputy"]
    assert {fleet.status(name).state for name in fleet.agents} == {"run"}


@pytest.mark.slow
def test_leader_with_minority_stands_down_before_takeover(fleet: Fleet) -> None:
    few = {"leader", "robot1"}
    fleet.cut(few, fleet.nodes.keys() - few - {"world"})
    fleet.run(0.6)
    assert fleet.leaders == []
    fleet.run(0.6)
    assert fleet.leaders == ["deputy"]
    fleet.run(3.0)
    assert fleet.status("robot1").state == "hold"
    fleet.heal()
    fleet.run(5.0)
    assert leader_names(fleet) == ["leader", "deputy"]
    assert fleet.status("robot1").state == "run"
    assert fleet.error() < 0.1


def test_second_standby_leads_if_leader_and_first_are_dead(fleet: Fleet) -> None:
    fleet.kill("deputy")
    fleet.kill("leader")
    fleet.run(1.2)
    assert fleet.leaders == ["reserve"]


@pytest.mark.parametrize("clock", [-3600.0, 3600.0])
def test_restarted_leader_with_wrong_clock_leads(fleet: Fleet, clock: float) -> None:
    fleet.kill("deputy")
    fleet.kill("reserve")
    fleet.nodes["leader"].clock_error = clock
    fleet.restart("leader")
    fleet.run(4.0)
    assert fleet.leaders == ["leader"]
    assert {fleet.status(name).state for name in fleet.agents} == {"run"}


@pytest.mark.slow
def test_restarting_each_agent_in_turn_keeps_leader(fleet: Fleet) -> None:
    for name in fleet.agents:
        fleet.restart(name)
        fleet.run(2.0)
        assert fleet.status(name).state == "run"
    assert leader_names(fleet) == ["leader"]


def test_bad_links_neither_split_team_nor_change_leader(fleet: Fleet) -> None:
    names = fleet.nodes.keys() - {"world"}
    fleet.links = dict.fromkeys(product(names, names), Link(loss=0.3, delay=(0.0, 0.1), twice=0.2))
    fleet.run(6.0)
    assert leader_names(fleet) == ["leader"]


def test_mission_without_standbys_sends_no_election_messages() -> None:
    fleet, result = Fleet(load("six_robots")), set()

    def listen(sample: Sample) -> tuple[Sample, ...]:
        result.add(sample.key)
        assert b"voted_term" not in (sample.attachment or b"")
        assert b"last_ballot" not in (sample.attachment or b"")
        return (sample,)

    fleet.meddle = listen
    fleet.run(1.0)
    assert not any(key.endswith(("ballot", "route")) for key in result)
    assert any(f"{name}/position" in result for name in fleet.mission.followers)
