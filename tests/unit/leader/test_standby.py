"""Standbys: their replies, and how they continue the relayed order when elected."""

from __future__ import annotations

from typing import Any, Literal

import pytest

from formation.leader.core import Leader
from formation.leader.driving import IDLE_SECONDS
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import Ballot
from formation.protocol.order import DRIVEN_ROUTE, Order, Place
from formation.ros2.messages import Text, decode
from formation.topics import BALLOT, ROUTE
from formation.wire import Now, Outgoing
from tests.support.fleet import at
from tests.unit.leader.leading import CURVED, SentPosition, arriving, ask, positions, relayed, status

TERM = int(1.6e9 * 1e9)


@pytest.fixture
def mission() -> Mission:
    """A mission with two standbys, in which one follower's vote is a majority."""
    return parse(CURVED.replace("[shapes.line]", "[standbys.cat]\n[standbys.dan]\n[shapes.line]"))


def elected(leader: Leader, mono: float, newest: Order | None = None) -> tuple[float, list[Outgoing]]:
    """Let bob vote for this candidate and relay this order; return when it led, and its outbox then."""
    received = Ballot(term=1, number=1, candidacy="candidate", mission=leader.mission.tag)
    for _ in range(300):
        reported = relayed(
            "bob", newest, voted_term=received.term, last_ballot=received.number, of=leader.mission
        )
        outbox = leader.step(at(mono), [arriving(reported, mono)])
        if leader.leads:
            return mono, outbox
        for out in outbox:
            if out.key == BALLOT.key(leader.name):
                received = json_message.decode(Ballot, decode(Text, out.payload).text.encode())
        mono += 0.02
    raise AssertionError("no candidate was elected")


def test_standby_accepts_mode_requests_but_no_shape_request(mission: Mission) -> None:
    standby = Leader(mission, "cat")
    newest = Order(term=TERM, beat=9, mode="run", shape="line")  # of rank 0: ann's
    assert newest.term % 64 == 0
    standby.step(at(0.0), [])
    standby.step(at(0.1), [arriving(relayed("bob", newest, voted_term=TERM, last_ballot=1, of=mission), 0.1)])
    reply = ask(standby, b'{"do":"shape","shape":"near"}')
    assert (reply.ok, reply.leads, reply.reason) == (False, False, "stands by; ann leads")
    for do, mode in (("run", "run"), ("hold", "hold"), ("stop", "stop"), ("release", "hold"), ("run", "run")):
        reply = ask(standby, do)
        assert (reply.robot, reply.ok, reply.leads, reply.mode) == ("cat", True, False, mode)


def test_listening_candidate_accepts_only_stop_and_hold(mission: Mission) -> None:
    leader = Leader(mission)
    leader.step(at(0.0), [])
    assert ask(leader, "run").reason == "has just started: ask again in a second"
    assert ask(leader, "hold").ok
    assert ask(leader, "stop").ok


def test_path_after_takeover_of_a_drive_waits_as_after_a_drive(mission: Mission) -> None:
    """The driver may still hold the stick, which moves the next leader only after a release."""
    standby = Leader(mission, "cat")
    place = Place(x=1.0, y=0.0, heading=0.0)
    newest = Order(term=TERM, beat=9, mode="run", shape="line", route=DRIVEN_ROUTE, place=place, driven=True)
    mono, _ = elected(standby, 0.0, newest)
    path = '{"do":"route","joins":true,"legs":[{"waypoints":[[3.0,0.0]],"speed":0.1}]}'
    reply = ask(standby, path, mono + 0.9 * IDLE_SECONDS)
    assert (reply.ok, reply.code) == (False, "driven")
    assert reply.reason.startswith("a driver drives by hand")
    assert ask(standby, path, mono + 1.1 * IDLE_SECONDS).ok


@pytest.mark.parametrize(("mine", "others"), [("hold", "run"), ("run", "hold")])
def test_leader_elected_again_keeps_own_and_relayed_hold(
    mission: Mission, mine: str, others: Literal["hold", "run"]
) -> None:
    leader = Leader(mission)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, mine).ok
    for k in range(1, 60):
        leader.step(at(mono + k / 50), [])
    assert not leader.leads
    newest = Order(term=leader.term + 1, beat=9, mode=others, shape="line", base_mode=others, time=1.0)
    elected(leader, mono + 5.0, newest)
    assert leader.mode == "hold"
    assert ask(leader, "run").mode == "run"


def test_stopped_standby_orders_stop_once_it_leads(mission: Mission) -> None:
    standby = Leader(mission, "cat")
    standby.step(at(0.0), [])
    ask(standby, "stop")
    newest = Order(term=TERM, beat=9, mode="run", shape="line", time=3.0)
    mono, outbox = elected(standby, 1.0, newest)
    (result,) = positions(mono, outbox)
    assert result.order.mode == "stop"
    assert (result.order.base_mode, result.order.time) == ("run", 3.0)
    assert ask(standby, "release").mode == "hold"
    assert ask(standby, "run").mode == "run"


def test_leading_standby_has_its_own_publisher_id(mission: Mission) -> None:
    standby = Leader(mission, "cat", publisher_id="cats")
    assert set(standby.subscriptions) == {
        "bob/position", "ann/ballot", "dan/ballot", "ann/route", "dan/route"
    }  # fmt: skip
    assert {key for _, key in standby.publications} == {
        "ann/position", "cat/status", "cat/ballot", "cat/route"
    }  # fmt: skip
    newest = Order(term=TERM, beat=9, mode="run", shape="near", time=3.0, base_mode="run", holding=True)
    mono, outbox = elected(standby, 0.0, newest)
    (result,) = positions(mono, outbox)
    assert (result.publisher_id, result.order.time, result.order.mode) == ("cats", 3.0, "hold")
    assert result.order.term % 64 == 1
    assert status("cat", outbox).leads
    # without votes its lease ends, and it sends no positions
    sent_at = [k / 50 for k in range(1, 100) if positions(0.0, standby.step(at(mono + k / 50), []))]
    assert not standby.leads
    assert 0.3 < max(sent_at) < 0.5 * mission.takeover
    mono, outbox = elected(standby, mono + 5.0, newest)
    (again,) = positions(mono, outbox)
    assert again.publisher_id not in {"", "cats"}
    assert again.order.beat == 1


def sent_north(mission: Mission) -> tuple[SentPosition, Outgoing]:
    """Last position and route message of a leader with a requested route to the north."""
    leader = Leader(mission)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}').ok
    outbox = leader.step(at(mono + 0.01), [])
    (last,) = positions(mono, outbox)
    (reported,) = (out for out in outbox if out.key == ROUTE.key("ann"))
    return last, reported


def test_standby_continues_received_route_after_takeover(mission: Mission) -> None:
    last, reported = sent_north(mission)
    standby = Leader(mission, "cat")
    standby.step(at(0.0), [])
    standby.step(at(0.1), [arriving(reported, 0.1)])
    began, _ = elected(standby, 0.12, last.order)
    assert standby.mode == "run"
    assert standby.where(began) == pytest.approx(last.pose.position, abs=1e-3)
    assert standby.plan.route.id == last.order.route != ""


def test_elected_standby_without_route_holds_until_route_arrives(mission: Mission) -> None:
    last, reported = sent_north(mission)
    standby = Leader(mission, "cat")
    began, outbox = elected(standby, 0.0, last.order)
    (result,) = positions(began, outbox)
    assert result.order.mode == "hold"
    assert result.pose.position == pytest.approx(last.pose.position, abs=1e-3)
    assert "does not know the route" in str(status("cat", outbox).reason)
    standby.step(at(began + 0.01), [arriving(reported, began + 0.01)])
    assert standby.mode == "run"
    assert standby.where(began + 0.01) == pytest.approx(last.pose.position, abs=1e-3)


def test_invalid_ballots_routes_and_positions_are_only_counted(mission: Mission) -> None:
    leader = Leader(mission)
    leader.step(at(0.0), [])
    for key in ("cat/ballot", "cat/route", "bob/position", "eve/position"):
        leader.step(at(0.1), [arriving(Outgoing(key, b"\x00\x01\x00\x00junk", b"junk"), 0.1)])
    assert leader.dropped == {"cat/ballot": 1, "cat/route": 1, "bob/position": 1, "eve/position": 1}


def test_standby_with_slow_clock_says_once_that_it_ignores_terms(mission: Mission) -> None:
    """Its clock is 25 h behind, so the fleet's term seems to begin a day ahead."""
    standby = Leader(mission, "cat")
    newest = Order(term=TERM, beat=9, mode="run", shape="line")
    early = TERM * 1e-9 - 25 * 3600.0
    for step in range(40):
        reported = relayed("bob", newest, voted_term=TERM, last_ballot=1, of=mission)
        standby.step(Now(0.5 * step, early + 0.5 * step), [arriving(reported, 0.5 * step)])
    (said,) = [note for note in standby.notes if "absurd" in note]
    assert said.startswith(
        "ignores what bob relays of the leader: absurd term: begins 90000 s from now, limit 86400 s; set"
    )


def test_only_listed_processes_are_candidates(mission: Mission) -> None:
    with pytest.raises(ValueError, match="ann, cat, dan"):
        Leader(mission, "bob")


def led(mission: Mission, *, readonly: bool = False, shadow: bool = False) -> list[bool]:
    """Whether ann leads in each step of 5 s; bob's agent votes for it; `shadow` adds a readonly agent."""
    leader, leads = Leader(mission), []
    received = Ballot(term=1, number=1, candidacy="candidate", mission=mission.tag)
    for k in range(250):
        vote: dict[str, Any] = {"voted_term": received.term, "last_ballot": received.number}
        result = [relayed("bob", None, readonly=readonly, of=mission, **vote)]
        if shadow:
            result.append(relayed("bob", None, readonly=True, publisher="shadow", of=mission))
        for out in leader.step(at(0.02 * k), [arriving(one, 0.02 * k) for one in result]):
            if out.key == BALLOT.key(leader.name):
                received = json_message.decode(Ballot, decode(Text, out.payload).text.encode())
        leads.append(leader.leads)
    return leads


def test_readonly_agent_does_not_cancel_its_robots_vote(mission: Mission) -> None:
    assert led(mission, shadow=True)[-100:] == [True] * 100


def test_readonly_agents_alone_elect_no_leader(mission: Mission) -> None:
    assert not any(led(mission, readonly=True))
