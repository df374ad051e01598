"""Gains as whoever leads orders them: said at once, kept by who goes on, refused with what is legal."""

from __future__ import annotations

import json

import pytest

from formation.election import LISTENING
from formation.mission import Mission
from formation.mission_file import load
from formation.order import Order, Tuned
from leader.core import Leader
from tests.formation import scenarios
from tests.leader.leading import arriving, ask, at, drive, leading, positions, relayed, status

SIX = load("six_robots")
TUNED = Tuned(k_p=3.0, k_i=0.5)


def tune(leader: Leader, **gains: object) -> tuple[bool, str]:
    reply = ask(leader, json.dumps({"do": "tune", **gains}).encode())
    return reply.ok, reply.reason


def going_on(mission: Mission, tuned: Tuned | None) -> Leader:
    """A leader that begins to lead where robots relay this."""
    before = Order(term=1, beat=9, mode="run", shape=mission.first_shape, tuned=tuned)
    leader = Leader(mission)
    leader.step(at(0.0), [])
    said = [
        relayed(name, before, of=mission)
        for name in mission.followers
        if mission.leader in mission.robots[name].neighbours
    ]
    leader.step(at(0.1), [arriving(one, 0.1) for one in said])
    leader.step(at(0.1 + LISTENING), [])
    assert leader.leads
    return leader


def test_gains_are_said_at_once_and_with_every_order_from_then_on() -> None:
    leader = leading(SIX)
    assert drive(leader, 0.05, 0.5)[-1].order.tuned is None
    ok, reason = tune(leader, k_p=3.0, k_i=0.5)
    assert ok
    assert reason.startswith("k_p = 3, k_i = 0.5; bears a delay of ")
    (at_once,) = positions(0.5511, leader.step(at(0.5511), []))
    assert at_once.order.tuned == TUNED
    assert {one.order.tuned for one in drive(leader, 0.6, 1.0)} == {TUNED}


def test_one_gain_leaves_the_other_as_it_was_ordered_last() -> None:
    leader = leading(SIX)
    assert tune(leader, k_p=3.0)[0]
    assert tune(leader, k_i=0.5)[0]
    assert drive(leader, 0.05, 0.2)[-1].order.tuned == TUNED
    assert tune(leader, k_p=SIX.law.k_p, k_i=SIX.law.k_i)[0]
    assert drive(leader, 0.3, 0.2)[-1].order.tuned is None  # the mission's again


def test_what_is_refused_changes_nothing() -> None:
    leader = leading(scenarios.ring(12, k_i=0.1, kind="paper"))
    ok, reason = tune(leader, k_i=30.0)
    assert not ok
    assert reason.startswith("k_i = 30: unstable, eigenvalue ")
    assert " needs k_i < " in reason
    assert reason.endswith(" at k_p = 2")
    assert drive(leader, 0.05, 0.2)[-1].order.tuned is None


def test_a_request_without_a_gain_or_with_what_is_none_is_refused_with_what_it_takes() -> None:
    leader = leading(SIX)
    assert tune(leader) == (False, "OperatorRequest: tune takes k_p or k_i")
    assert tune(leader, k_p=3.0, factor=2.0) == (False, "OperatorRequest: tune takes k_p or k_i")
    assert tune(leader, k_p=-1.0)[1].startswith("OperatorRequest: k_p: ")
    assert tune(leader, observer_gain=5.0)[1].startswith("OperatorRequest: observer_gain: ")


def test_who_goes_on_orders_the_gains_that_robots_relay() -> None:
    assert drive(going_on(SIX, TUNED), 2.0, 0.2)[-1].order.tuned == TUNED
    assert drive(going_on(SIX, None), 2.0, 0.2)[-1].order.tuned is None


@pytest.mark.parametrize("tuned", [Tuned(k_p=60.0, k_i=1.0), Tuned(k_p=2.0, k_i=50.0)])
def test_gains_that_the_graph_does_not_bear_are_not_gone_on_with(tuned: Tuned) -> None:
    assert drive(going_on(SIX, tuned), 2.0, 0.2)[-1].order.tuned is None


def test_the_status_of_who_leads_says_which_gains_are_ordered() -> None:
    leader = leading(SIX)
    assert tune(leader, k_p=3.0, k_i=0.5)[0]
    assert status(SIX.leader, leader.step(at(0.6), []))["gains"] == "k_p = 3, k_i = 0.5"
