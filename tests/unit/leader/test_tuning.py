"""Gains as whoever leads orders them: said at once, kept by who goes on, refused with what is legal."""

from __future__ import annotations

import json

import pytest

from formation.leader.core import Leader
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.election import LISTENING_TIME
from formation.protocol.order import Order, Tuned
from tests.unit.formation import scenarios
from tests.unit.leader.leading import arriving, ask, at, drive, leading, positions, relayed, status

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
    result = [
        relayed(name, before, of=mission)
        for name in mission.followers
        if mission.leader in mission.robots[name].neighbours
    ]
    leader.step(at(0.1), [arriving(one, 0.1) for one in result])
    leader.step(at(0.1 + LISTENING_TIME), [])
    assert leader.leads
    return leader


def test_gains_are_sent_immediately_and_in_every_order() -> None:
    leader = leading(SIX)
    assert drive(leader, 0.05, 0.5)[-1].order.tuned is None
    ok, reason = tune(leader, k_p=3.0, k_i=0.5)
    assert ok
    assert reason.startswith("k_p = 3, k_i = 0.5; bears a delay of ")
    (at_once,) = positions(0.5511, leader.step(at(0.5511), []))
    assert at_once.order.tuned == TUNED
    assert {one.order.tuned for one in drive(leader, 0.6, 1.0)} == {TUNED}


def test_delay_margin_leaves_out_an_integral_that_the_law_lacks() -> None:
    (_, with_integral), (_, without) = (
        tune(leading(SIX.under(law)), k_p=3.0, k_i=2.9) for law in ("paper", "proportional")
    )
    (_, proportional) = tune(leading(SIX.under("proportional")), k_p=3.0, k_i=0.0)
    assert without.partition("; ")[2] == proportional.partition("; ")[2] != with_integral.partition("; ")[2]


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


def test_request_with_missing_or_invalid_gain_is_refused() -> None:
    leader = leading(SIX)
    assert tune(leader) == (False, "OperatorRequest: tune takes k_p or k_i")
    assert tune(leader, k_p=3.0, factor=2.0) == (False, "OperatorRequest: tune takes k_p or k_i")
    assert tune(leader, k_p=-1.0)[1].startswith("OperatorRequest: k_p: ")
    assert tune(leader, observer_gain=5.0)[1].startswith("OperatorRequest: observer_gain: ")


def test_new_leader_orders_the_relayed_gains() -> None:
    assert drive(going_on(SIX, TUNED), 2.0, 0.2)[-1].order.tuned == TUNED
    assert drive(going_on(SIX, None), 2.0, 0.2)[-1].order.tuned is None


@pytest.mark.parametrize("tuned", [Tuned(k_p=60.0, k_i=1.0), Tuned(k_p=2.0, k_i=50.0)])
def test_gains_unstable_on_graph_are_not_adopted(tuned: Tuned) -> None:
    assert drive(going_on(SIX, tuned), 2.0, 0.2)[-1].order.tuned is None


def test_leader_status_shows_the_ordered_gains() -> None:
    leader = leading(SIX)
    assert tune(leader, k_p=3.0, k_i=0.5)[0]
    result = status(SIX.leader, leader.step(at(0.6), []))
    assert (result.k_p, result.k_i) == (3.0, 0.5)
