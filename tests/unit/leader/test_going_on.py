"""A restarted leader continues from the order that robots relay, or waits for run."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from formation.leader.core import CATCH_UP_TIME, Leader
from formation.mission.file import load, parse
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.election import READING_TIME, TERM_EXPIRY_TIME
from formation.protocol.order import Mode, Order, Place, Slots, newer
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import AgentState
from formation.wire import Outgoing
from tests.support.fleet import Fleet, at
from tests.unit.leader.leading import (
    CURVED,
    MISSION,
    SentPosition,
    about_to_lead,
    arriving,
    ask,
    drive,
    leading,
    listens,
    positions,
    relayed,
    status,
)

TERM = int(1.6e9 * 1e9)
MODES = (["run"], ["hold"], ["stop"], ["hold", "stop"])


def last_of(*requests: str) -> SentPosition:
    """Last position of a leader that leads for 5 s and receives these requests after 4 s."""
    leader = about_to_lead()
    drive(leader, 0.0, 4.0)
    for request in requests:
        ask(leader, request)
    return drive(leader, 4.0, 1.0)[-1]


def restarted(newest: Order, mono: float, **how: Any) -> Leader:
    """A new leader that receives this relayed order at `mono`."""
    leader = Leader(MISSION, publisher_id="another", **how)
    leader.step(at(mono - 0.05), [])
    leader.step(at(mono), [arriving(relayed("bob", newest), mono)])
    return leader


def test_leader_listens_for_a_second_before_its_first_position() -> None:
    leader = Leader(MISSION)
    result = [*listens(leader), *(out for k in range(1, 100) for out in leader.step(at(k / 100), []))]
    assert {out.key for out in result} == {"ann/status"}
    assert status("ann", result[:1]).state == "listening"
    (first,) = positions(1.0, leader.step(at(1.0), []))
    assert (first.pose.position, first.order.beat, first.order.mode) == (2.0 - 1.0j, 1, "run")


def test_leader_starts_after_receiving_every_linked_robot() -> None:
    leader = Leader(MISSION)
    assert leader.subscriptions == ("bob/position",)
    leader.step(at(0.0), [])
    (first,) = positions(0.3, leader.step(at(0.3), [arriving(relayed("bob", None), 0.3)]))
    assert first.order.beat == 1


@pytest.mark.parametrize("requested", MODES)
def test_restarted_leader_continues_from_last_order(requested: list[str]) -> None:
    last = last_of(*requested, '{"do":"shape","shape":"near"}', '{"do":"scale","factor":1.5}')
    after = restarted(last.order, 6.0)
    first = drive(after, 6.0, 0.04) or positions(6.0, after.step(at(6.04), []))
    assert abs(first[0].pose.position - last.pose.position) < 0.02
    assert (first[0].order.mode, first[0].order.holding) == (last.order.mode, last.order.holding)
    assert first[0].order.shape == "near"
    assert first[0].order.term > last.order.term
    if after.mode == "stop":
        assert ask(after, "release").mode == "hold"
    assert ask(after, "run").mode == "run"
    result = drive(after, 6.08, 20.0)
    assert (result[-1].order.shape, result[-1].order.scale, result[-1].order.slots) == ("near", 1.5, None)


def test_restarted_leader_continues_shape_transition() -> None:
    def bobs_slot(leader: Leader) -> complex:
        return leader.plan.shape_transition.placed_shape.slot(MISSION, "bob")

    before = leading()
    ask(before, '{"do":"shape","shape":"near"}')
    last = drive(before, 0.04, 1.2)[-1].order
    assert last.slots is not None
    after = restarted(last, 5.0)
    assert bobs_slot(after) == pytest.approx(bobs_slot(before), abs=1e-6)
    slots = [bobs_slot(after)]
    for k in range(100):
        after.step(at(5.04 + 0.04 * k), [])
        slots.append(bobs_slot(after))
    assert slots[-1] == pytest.approx(-0.5)
    assert max(abs(b - a) for a, b in pairwise(slots)) < 0.7 * 0.04


@pytest.mark.parametrize("requested", MODES)
def test_leader_continues_order_received_after_its_start(requested: list[str]) -> None:
    last = last_of(*requested)
    after = Leader(MISSION, publisher_id="another")
    listens(after, 6.0)
    assert drive(after, 6.04, 1.5)[-1].pose.position != last.pose.position, "it has received no order yet"
    first = positions(7.52, after.step(at(7.52), [arriving(relayed("bob", last.order), 7.5)]))[0]
    assert abs(first.pose.position - last.pose.position) < 0.02
    assert (first.order.mode, first.order.holding) == (last.order.mode, last.order.holding)
    assert first.order.term > last.order.term


def test_older_relayed_order_does_not_reset_leader() -> None:
    leader = about_to_lead()
    result = drive(leader, 0.0, 2.0)[-1].order
    leader.step(at(2.04), [arriving(relayed("bob", result), 2.03)])
    old = Order(term=TERM, beat=9, mode="stop", shape="line", time=1.0)
    leader.step(at(2.08), [arriving(relayed("bob", old), 2.07)])
    assert drive(leader, 2.12, 1.0)[-1].order.mode == "run"
    assert leader.route_time > 2.5


def test_anew_restarts_route_but_keeps_stop() -> None:
    last = last_of("stop").order
    after = restarted(last, 6.0, anew=True)
    assert (after.mode, after.route_time, after.where(6.0)) == ("stop", 0.0, 2.0 - 1.0j)
    assert after.term > last.term


@pytest.mark.parametrize(
    ("do", "relays", "mode"),
    [("stop", "run", "stop"), ("hold", "run", "hold"), ("run", "run", "run"), ("run", "stop", "stop")],
)
def test_request_while_listening_overrides_relayed_mode_except_stop(do: str, relays: Mode, mode: str) -> None:
    relaying = Order(term=TERM, beat=9, mode=relays, shape="line", time=1.0)
    leader = Leader(MISSION)
    leader.step(at(0.0), [])
    assert ask(leader, do).ok
    leader.step(at(0.1), [arriving(relayed("bob", relaying), 0.1)])
    assert leader.leads
    assert leader.mode == mode
    assert leader.route_time == 1.0


@pytest.mark.parametrize(
    "request_",
    [
        '{"do":"shape","shape":"near"', '{"do":"rotate","degrees":3.0', '{"do":"scale","factor":2.0',
        '{"do":"speed","speed":0.1,"degrees":0.0', '{"do":"route","legs":[{"speed":0.1,"heading_deg":0.0}]',
    ],
)  # fmt: skip
def test_listening_leader_refuses_shape_and_route_requests(request_: str) -> None:
    leader, request = Leader(MISSION), f'{request_},"id":"a"}}'
    listens(leader)
    assert ask(leader, request).reason == "has just started: ask again in a second"
    leader.step(at(1.0), [])
    assert ask(leader, request).ok


def test_team_holds_after_leader_ends_without_standbys() -> None:
    leader = about_to_lead()
    before = drive(leader, 0.0, 1.0)[-1]
    (last,) = positions(1.1, leader.halt(at(1.1), "SIGTERM"))
    assert newer(last.order, before.order)
    assert (last.order.mode, last.order.base_mode, last.order.holding) == ("hold", "hold", False)
    for hold in (False, True):
        after = restarted(last.order, 3.0, hold=hold)
        assert (after.mode, after.route_time) == ("hold", last.order.time)
        assert ask(after, "run").mode == "run"
    stopped = about_to_lead()
    drive(stopped, 0.0, 1.0)
    ask(stopped, "stop")
    (last,) = positions(1.0, stopped.halt(at(1.0), "SIGTERM"))
    assert last.order.mode == "stop"


def test_route_of_another_mission_file_is_not_continued() -> None:
    elsewhere = Order(
        term=TERM, beat=9, mode="run", shape="line", time=2.0, place=Place(x=9.0, y=9.0, heading=1.0)
    )
    leader = restarted(elsewhere, 5.0)
    result = drive(leader, 5.04, 2.0)
    assert {(one.order.mode, one.pose.position) for one in result} == {("hold", 9.0 + 9.0j)}
    assert "does not know the route" in ask(leader, "run").reason
    reply = ask(leader, b'{"do":"speed","speed":0.5,"degrees":0.0}')
    assert (reply.ok, reply.mode) == (True, "hold")
    assert "from where it is, once you order run" in reply.reason
    assert {one.pose.position for one in drive(leader, 7.04, 1.0)} == {9.0 + 9.0j}
    assert ask(leader, "run").mode == "run"
    assert drive(leader, 8.04, 2.0)[-1].pose.position.real > 9.9


@pytest.mark.parametrize(
    ("shape", "slots"),
    [("star", None), *(("line", Slots(mix=mix)) for mix in ({"line": 0.0}, {"line": 0.5}, {"star": 1.0}))],
)
def test_order_with_invalid_slots_is_not_continued(shape: str, slots: Slots | None) -> None:
    impossible = Order(term=TERM, beat=9, mode="run", shape=shape, time=5.0, slots=slots)
    leader = restarted(impossible, 5.0)
    assert (leader.leads, leader.plan.shape_transition.ordered.shape, leader.route_time) == (
        True,
        "line",
        0.0,
    )
    assert drive(leader, 5.04, 1.0)[-1].order.slots is None
    assert leader.dropped == {"bob/position": 1}


def test_leader_stands_by_after_receiving_a_newer_term() -> None:
    first, second = about_to_lead(), about_to_lead(MISSION, 5.0, publisher_id="second")
    drive(first, 0.0, 5.0)
    *_, old, newer = (result.order for result in drive(second, 5.0, 1.0))
    first.step(at(5.96), [arriving(relayed("bob", old), 5.96)])
    assert first.step(at(6.0), [arriving(relayed("bob", newer), 6.0)])[0].key == "ann/status"
    assert not first.leads
    assert ask(first, "run").leads is False
    assert ask(first, b'{"do":"rotate","degrees":3.0}').reason.startswith("stands by")
    first.step(at(7.2), [])
    assert first.candidacy.leading
    assert first.candidacy.term > second.candidacy.term


def test_release_given_before_leading_does_not_end_stop() -> None:
    stopped = Order(term=TERM, beat=9, mode="stop", shape="line", time=1.0)
    leader = restarted(stopped, 5.0)
    late = ask(leader, b'{"do":"release","id":"a","age":1.5}', 6.0)
    assert (late.ok, late.mode) == (False, "stop")
    assert ask(leader, b'{"do":"release","id":"b"}').mode == "hold"


RUNNING = Order(term=TERM, beat=90, mode="run", shape="near", time=2.0)
PAIR = load("turtlebot3_pair")
TWO = parse(
    CURVED.replace("bob = [-1.0, 0.0]", "bob = [-1.0, 0.0]\neve = [-2.0, 0.0]").replace(
        "bob = [-0.5, 0.0]", "bob = [-0.5, 0.0]\neve = [-1.5, 0.0]"
    )
    + '[robots.eve]\nneighbours = ["ann"]\nstart = { x = 0.0, y = 1.0 }\n'
)


def begun(of: Mission, *received: tuple[str, Order, bool], hold: bool = True) -> Leader:
    """A leader that has received positions: robot, relayed order, and whether that is stale."""
    leader = Leader(of, hold=hold)
    leader.step(at(0.0), [])
    for robot, what, stale in received:
        leader.step(at(0.1), [arriving(relayed(robot, what, of=of, stale=stale), 0.1)])
    if not leader.leads:
        leader.step(at(1.1), [])
    return leader


@pytest.mark.parametrize("late", [False, True], ids=["while listening", "while leading"])
@pytest.mark.parametrize(
    ("stale", "hold", "mode"), [(True, True, "hold"), (True, False, "run"), (False, True, "run")]
)
def test_hold_option_waits_for_run_after_an_outage(*, late: bool, stale: bool, hold: bool, mode: str) -> None:
    leader = begun(MISSION, *(() if late else (("bob", RUNNING, stale),)), hold=hold)
    if late:
        assert leader.mode == ("hold" if hold else "run")
        leader.step(at(2.0), [arriving(relayed("bob", RUNNING, stale=stale), 2.0)])
    assert (leader.mode, leader.plan.shape_transition.ordered.shape) == (mode, "near")
    assert leader.route_time == pytest.approx(2.0, abs=0.01)
    assert ask(leader, "run").mode == "run"


@pytest.mark.parametrize("order", [("bob", "eve"), ("eve", "bob")])
@pytest.mark.parametrize(("beat", "mode"), [(90, "hold"), (40, "run")])
def test_stale_newest_order_makes_leader_hold(order: tuple[str, str], beat: int, mode: str) -> None:
    """Not a stale order with an earlier beat than the others: its robot was cut off before."""
    stale = RUNNING.model_copy(update={"beat": beat})
    received = {"bob": ("bob", stale, True), "eve": ("eve", RUNNING, False)}
    assert begun(TWO, *(received[name] for name in order)).mode == mode


def test_stop_and_hold_survive_an_outage() -> None:
    rest = RUNNING.model_copy(update={"mode": "stop", "holding": True})
    leader = begun(MISSION, ("bob", rest, True))
    assert leader.mode == "stop"
    assert ask(leader, "release").mode == "hold"


def test_standby_with_hold_forgets_run_after_term_expiry() -> None:
    """The robots were restarted and relay no order; the standby was not restarted."""
    mission = parse(CURVED.replace("[shapes.line]", "[standbys.cat]\n[shapes.line]"))
    for wait, under_way in ((0.5 * TERM_EXPIRY_TIME, True), (2.0 * TERM_EXPIRY_TIME, False)):
        standby = Leader(mission, "cat", hold=True)
        for k in range(2):
            what = RUNNING.model_copy(update={"beat": 90 + k})
            standby.step(at(0.1 * k), [arriving(relayed("bob", what, of=mission), 0.1 * k)])
        assert standby._under_way(at(0.1 + wait)) is under_way


@pytest.mark.parametrize(("seconds", "mode"), [(2.0, "run"), (TERM_EXPIRY_TIME + 1.0, "hold")])
def test_team_waits_for_run_only_after_a_long_outage(seconds: float, mode: str) -> None:
    fleet = Fleet(PAIR, seed=1)
    fleet.run(4.0)
    fleet.kill("leader")
    fleet.run(seconds)
    fleet.restart("leader")
    leader = Leader(PAIR, hold=True, publisher_id="another")
    fleet.nodes["leader"].core = fleet.candidates["leader"] = fleet.leader = leader
    fleet.run(3.0)
    assert leader.mode == mode
    assert {agent.decision.state for agent in fleet.agents.values()} == {AgentState(mode)}
    assert fleet.ask("leader", "run").ok
    fleet.run(1.0)
    assert {agent.decision.state for agent in fleet.agents.values()} == {AgentState.RUN}


@pytest.mark.parametrize(("seconds", "mode"), [(2.0, "run"), (TERM_EXPIRY_TIME + 1.0, "hold")])
def test_leader_waits_for_run_after_it_slept_for_long(seconds: float, mode: str) -> None:
    """Such as one on a laptop with a closed lid; its robots hold meanwhile."""
    leader = leading(PAIR, hold=True)
    ask(leader, "run", 0.1)
    sent = drive(leader, 0.1, 2.0)
    assert sent[-1].order.mode == "run"
    woken = sent[-1].mono + seconds
    assert {one.order.mode for one in positions(woken, leader.step(at(woken), []))} == {mode}
    assert ask(leader, "run", woken + 0.1).mode == "run"


STOPPED = Order(
    term=TERM, beat=90, mode="stop", shape="line", time=2.0, place=Place(x=2.5677, y=-0.7933, heading=0.35)
)
UNREAD = "order not signed by ann: no certificate has come yet for the key that signed"


def relays(leader: Leader, robot: str, what: Order, mono: float, unverified: str = "") -> list[Outgoing]:
    """Step a leader that receives this relayed order."""
    sample = arriving(relayed(robot, what, of=leader.mission), mono)
    return leader.step(at(mono), [sample._replace(unverified=unverified)])


@pytest.mark.parametrize("hold", [False, True])
def test_leader_that_receives_nothing_sends_no_orders(*, hold: bool) -> None:
    leader = Leader(MISSION, hold=hold)
    assert drive(leader, 0.0, 4.0) == []
    assert status("ann", leader.step(at(4.3), [])).reason == Reason(Code.NO_ROBOT)
    assert leader.due > 4.3
    assert positions(4.5, relays(leader, "bob", STOPPED, 4.5))[0].order.mode == "stop"
    assert leader.route_time == 2.0


def test_leader_waits_until_it_can_read_the_relayed_order() -> None:
    leader = Leader(MISSION)
    assert positions(0.1, relays(leader, "bob", STOPPED, 0.1, UNREAD)) == []
    assert drive(leader, 0.14, 1.5) == []
    assert positions(1.7, relays(leader, "bob", STOPPED, 1.7))[0].order.mode == "stop"
    assert leader.route_time == 2.0


@pytest.mark.parametrize("unverified", [UNREAD, ""], ids=["unverified", "certificate only"])
def test_leader_holds_until_run_if_relayed_order_stays_unread(unverified: str) -> None:
    leader = Leader(MISSION, publisher_id="new")
    fresh = relayed("bob", STOPPED if unverified else None, term=0 if unverified else TERM)
    leader.step(at(0.0), [arriving(fresh, 0.0)._replace(unverified=unverified)])
    assert leader.candidacy.due == READING_TIME
    sent = drive(leader, 0.04, READING_TIME + 1.0)
    assert {one.order.mode for one in sent} == {"hold"}
    assert status("ann", leader.step(at(4.5), [])).reason == Reason(Code.ORDER_UNREAD)
    assert not ask(leader, '{"do":"run","id":"a","ends":["another"]}', 4.5).ok
    assert ask(leader, "run", 4.5).mode == "run"
    assert status("ann", leader.step(at(5.1), [])).reason is None


@pytest.mark.parametrize("hold", [False, True])
def test_own_relayed_order_hides_no_earlier_stop(*, hold: bool) -> None:
    leader = leading(TWO, hold=hold)
    relays(leader, "bob", drive(leader, 0.04, 0.1)[-1].order, 0.2)
    relays(leader, "eve", STOPPED, 0.3)
    assert (leader.mode, leader.route_time) == ("stop", 2.0)


@pytest.mark.parametrize(("what", "mono"), [(RUNNING, 0.3), (STOPPED, 0.3 + CATCH_UP_TIME)])
def test_own_relayed_order_hides_earlier_run_and_any_order_later(what: Order, mono: float) -> None:
    leader = leading(TWO)
    relays(leader, "bob", drive(leader, 0.04, 0.1)[-1].order, 0.2)
    drive(leader, 0.24, mono - 0.24)
    relays(leader, "eve", what, mono)
    assert leader.mode == "run"
    assert leader.route_time == pytest.approx(mono, abs=0.05)


@pytest.mark.parametrize("ends", [(), ("hold-of-another-process",)])
def test_earlier_run_starts_no_leader_that_waits(ends: tuple[str, ...]) -> None:
    """Be it a copy, or late: a hold of the leader's own has an id of this process."""
    for leader, age in ((leading(PAIR, hold=True, publisher_id="new"), 150.0), (slept(), 50.0)):
        early = json_message.encode(OperatorRequest(do="run", id="early", ends=ends))
        assert not json_message.decode(OperatorReply, leader.request(early, 100.0)).ok
        assert leader.mode == "hold"
        (named,) = {ask(leader, '{"do":"query"}', 100.0).hold}
        aged = OperatorRequest(do="run", id="late", ends=(named,), age=age)
        assert not ask(leader, json_message.encode(aged), 100.0).ok
        assert ask(leader, "run", 100.0).mode == "run"


def slept() -> Leader:
    """A leader with --hold that was told to run, and then slept."""
    leader = leading(PAIR, hold=True)
    ask(leader, "run", 0.1)
    drive(leader, 0.1, 1.0)
    leader.step(at(99.0), [])
    return leader
