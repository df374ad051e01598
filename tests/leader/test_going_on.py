"""A leader that starts again goes on from what the robots relay."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from formation.mission import Mission
from formation.mission_file import parse
from formation.order import Order, Place, Slots
from leader.core import Leader
from tests.leader.leading import (
    CURVED,
    arriving,
    ask,
    at,
    drive,
    leading,
    listened,
    positions,
    relayed,
    status,
)

TERM = int(1.6e9 * 1e9)
MODES = (
    [b'{"do":"run"}'],
    [b'{"do":"hold"}'],
    [b'{"do":"stop"}'],
    [b'{"do":"hold"}', b'{"do":"stop"}'],
)


@pytest.fixture
def mission() -> Mission:
    return parse(CURVED)


def restarted(mission: Mission, newest: Order, mono: float, **how: Any) -> Leader:
    """A leader that starts where a robot relays this order, and has heard it at `mono`."""
    leader = Leader(mission, voice="another", **how)
    leader.step(at(mono - 0.05), [])
    leader.step(at(mono), [arriving(relayed("bob", newest, of=mission), mono)])
    return leader


def test_a_leader_that_hears_nobody_says_nothing_of_the_team_for_a_second(mission: Mission) -> None:
    leader = Leader(mission)
    said = [out for k in range(100) for out in leader.step(at(k / 100), [])]
    assert {out.key for out in said} == {"ann/status"}
    assert status("ann", said[:1])["state"] == "listening"
    (first,) = positions(1.0, leader.step(at(1.0), []))
    assert (first.pose.position, first.order.beat, first.order.mode) == (2.0 - 1.0j, 1, "run")


def test_a_leader_leads_as_soon_as_it_has_heard_every_robot_that_it_is_linked_with(mission: Mission) -> None:
    leader = Leader(mission)
    assert leader.subscriptions == ("bob/position",)
    leader.step(at(0.0), [])
    (first,) = positions(0.3, leader.step(at(0.3), [arriving(relayed("bob", None, of=mission), 0.3)]))
    assert first.order.beat == 1


@pytest.mark.parametrize("asked", MODES)
def test_a_leader_that_starts_again_goes_on_where_the_one_before_it_was(
    mission: Mission, asked: list[bytes]
) -> None:
    before = listened(mission)
    drive(before, 0.0, 4.0)
    for request in (*asked, b'{"do":"shape","shape":"near"}', b'{"do":"scale","factor":1.5}'):
        ask(before, request)
    last = drive(before, 4.0, 1.0)[-1]
    after = restarted(mission, last.order, 6.0)
    first = drive(after, 6.0, 0.04) or positions(6.0, after.step(at(6.04), []))
    assert abs(first[0].pose.position - last.pose.position) < 0.02
    assert (first[0].order.mode, first[0].order.holding) == (last.order.mode, last.order.holding)
    assert first[0].order.shape == "near"
    assert first[0].order.term > last.order.term
    if after.mode == "stop":
        assert ask(after, b'{"do":"release"}').mode == "hold"
    assert ask(after, b'{"do":"run"}').mode == "run"
    said = drive(after, 6.08, 20.0)
    assert (said[-1].order.shape, said[-1].order.scale, said[-1].order.slots) == ("near", 1.5, None)


def test_the_figure_goes_on_from_where_it_was(mission: Mission) -> None:
    before = leading(mission)
    ask(before, b'{"do":"shape","shape":"near"}')
    last = drive(before, 0.04, 1.2)[-1].order
    assert last.slots is not None
    after = restarted(mission, last, 5.0)
    assert after.figure.slot(mission, "bob") == pytest.approx(before.figure.slot(mission, "bob"), abs=1e-6)
    slots = [after.figure.slot(mission, "bob")]
    for k in range(100):
        after.step(at(5.04 + 0.04 * k), [])
        slots.append(after.figure.slot(mission, "bob"))
    assert slots[-1] == pytest.approx(-0.5)
    assert max(abs(b - a) for a, b in pairwise(slots)) < 0.7 * 0.04


@pytest.mark.parametrize("asked", MODES)
def test_a_leader_whose_links_come_later_than_it_listens_goes_on_after_all(
    mission: Mission, asked: list[bytes]
) -> None:
    before = listened(mission)
    drive(before, 0.0, 4.0)
    for request in asked:
        ask(before, request)
    last = drive(before, 4.0, 1.0)[-1]
    after = Leader(mission, voice="another")
    assert drive(after, 6.0, 1.5)[-1].pose.position != last.pose.position, "it has heard nobody"
    first = positions(7.52, after.step(at(7.52), [arriving(relayed("bob", last.order, of=mission), 7.5)]))[0]
    assert abs(first.pose.position - last.pose.position) < 0.02
    assert (first.order.mode, first.order.holding) == (last.order.mode, last.order.holding)
    assert first.order.term > last.order.term


def test_once_a_robot_follows_nobody_elses_word_takes_a_leader_back(mission: Mission) -> None:
    leader = listened(mission)
    said = drive(leader, 0.0, 2.0)[-1].order
    leader.step(at(2.04), [arriving(relayed("bob", said, of=mission), 2.03)])
    old = Order(term=TERM, beat=9, mode="stop", shape="line", time=1.0)
    leader.step(at(2.08), [arriving(relayed("bob", old, of=mission), 2.07)])
    assert drive(leader, 2.12, 1.0)[-1].order.mode == "run"
    assert leader.route_time > 2.5


def test_hold_is_for_a_team_that_is_not_under_way(mission: Mission) -> None:
    last = drive(listened(mission), 0.0, 2.0)[-1].order
    assert restarted(mission, last, 4.0, hold=True).mode == "run"
    assert leading(mission, hold=True).mode == "hold"


def test_anew_begins_at_the_start_but_a_stop_stays(mission: Mission) -> None:
    before = listened(mission)
    drive(before, 0.0, 4.0)
    ask(before, b'{"do":"stop"}')
    last = drive(before, 4.0, 1.0)[-1].order
    after = restarted(mission, last, 6.0, anew=True)
    assert (after.mode, after.route_time, after.where(6.0)) == ("stop", 0.0, 2.0 - 1.0j)
    assert after.term > last.term


@pytest.mark.parametrize(
    ("request_", "mode"), [(b'{"do":"stop"}', "stop"), (b'{"do":"hold"}', "hold"), (b'{"do":"run"}', "run")]
)
def test_what_is_asked_while_it_listens_outranks_what_it_goes_on_with(
    mission: Mission, request_: bytes, mode: str
) -> None:
    relaying = Order(term=TERM, beat=9, mode="run", shape="line", time=1.0)
    leader = Leader(mission)
    leader.step(at(0.0), [])
    assert ask(leader, request_).ok
    leader.step(at(0.1), [arriving(relayed("bob", relaying, of=mission), 0.1)])
    assert leader.leads
    assert leader.mode == mode
    assert leader.route_time == 1.0


def test_a_stop_that_is_relayed_is_not_undone_by_what_was_asked_while_it_listened(mission: Mission) -> None:
    stopped = Order(term=TERM, beat=9, mode="stop", shape="line", time=1.0)
    leader = Leader(mission)
    leader.step(at(0.0), [])
    ask(leader, b'{"do":"run"}')
    leader.step(at(0.1), [arriving(relayed("bob", stopped, of=mission), 0.1)])
    assert leader.mode == "stop"


@pytest.mark.parametrize("do", ["shape", "rotate", "scale", "speed", "route"])
def test_while_it_listens_it_knows_too_little_for_anything_else(mission: Mission, do: str) -> None:
    leader = Leader(mission)
    leader.step(at(0.0), [])
    what = {
        "shape": '"shape":"near"',
        "rotate": '"degrees":3.0',
        "scale": '"factor":2.0',
        "speed": '"speed":0.1,"degrees":0.0',
        "route": '"legs":[{"speed":0.1,"heading_deg":0.0}]',
    }[do]
    request = f'{{"do":"{do}",{what},"id":"a"}}'.encode()
    assert ask(leader, request).reason == "has just started: ask again in a second"
    leader.step(at(1.0), [])
    assert ask(leader, request).ok


def test_its_last_words_leave_what_it_was_told_to_whoever_goes_on(mission: Mission) -> None:
    leader = listened(mission)
    drive(leader, 0.0, 1.0)
    (last,) = positions(1.0, leader.halt(at(1.0), "SIGTERM"))
    assert (last.order.mode, last.order.told, last.order.holding) == ("hold", "run", False)
    assert restarted(mission, last.order, 3.0).mode == "run"
    stopped = listened(mission)
    drive(stopped, 0.0, 1.0)
    ask(stopped, b'{"do":"stop"}')
    (last,) = positions(1.0, stopped.halt(at(1.0), "SIGTERM"))
    assert last.order.mode == "stop"


def test_a_route_of_another_mission_file_is_not_gone_on_with(mission: Mission) -> None:
    elsewhere = Order(
        term=TERM, beat=9, mode="run", shape="line", time=2.0, place=Place(x=9.0, y=9.0, heading=1.0)
    )
    leader = restarted(mission, elsewhere, 5.0)
    said = drive(leader, 5.04, 2.0)
    assert {(one.order.mode, one.pose.position) for one in said} == {("hold", 9.0 + 9.0j)}
    assert "does not know the route" in ask(leader, b'{"do":"run"}').reason
    assert ask(leader, b'{"do":"speed","speed":0.5,"degrees":0.0}').mode == "run"
    assert drive(leader, 7.04, 2.0)[-1].pose.position.real > 9.9


def test_an_order_of_unknown_shapes_is_not_gone_on_with(mission: Mission) -> None:
    leader = restarted(mission, Order(term=TERM, beat=9, mode="run", shape="star", time=5.0), 5.0)
    assert leader.leads
    assert (leader.shape, leader.route_time) == ("line", 0.0)
    assert leader.dropped == {"bob/position": 1}


@pytest.mark.parametrize("mix", [{"line": 0.0}, {"line": 0.5}, {"star": 1.0}])
def test_an_order_whose_slots_are_none_is_not_gone_on_with(mission: Mission, mix: dict[str, float]) -> None:
    impossible = Order(term=TERM, beat=9, mode="run", shape="line", time=5.0, slots=Slots(mix=mix))
    leader = restarted(mission, impossible, 5.0)
    assert drive(leader, 5.04, 1.0)[-1].order.slots is None
    assert leader.dropped == {"bob/position": 1}


def test_two_leaders_by_mistake_do_not_both_go_on(mission: Mission) -> None:
    first, second = listened(mission), listened(mission, 5.0, voice="second")
    drive(first, 0.0, 5.0)
    *_, old, newer = (said.order for said in drive(second, 5.0, 1.0))
    first.step(at(5.96), [arriving(relayed("bob", old, of=mission), 5.96)])
    assert first.step(at(6.0), [arriving(relayed("bob", newer, of=mission), 6.0)])[0].key == "ann/status"
    assert not first.leads
    assert ask(first, b'{"do":"run"}').leads is False
    assert ask(first, b'{"do":"rotate","degrees":3.0}').reason.startswith("stands by")


def test_a_release_from_before_it_led_does_not_undo_a_stop_that_it_goes_on_with(mission: Mission) -> None:
    stopped = Order(term=TERM, beat=9, mode="stop", shape="line", time=1.0)
    leader = restarted(mission, stopped, 5.0)
    late = ask(leader, b'{"do":"release","id":"a","age":1.5}', 6.0)
    assert (late.ok, late.mode) == (False, "stop")
    assert ask(leader, b'{"do":"release","id":"b"}').mode == "hold"
