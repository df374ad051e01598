"""Candidates: who stands by says so, and goes on from what the robots relay when it is elected."""

from __future__ import annotations

from typing import Any, Literal

import pytest

from formation.leader.core import Leader
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol import order
from formation.protocol.order import Ballot, Order
from formation.ros2.messages import Text, decode
from formation.topics import BALLOT, ROUTE
from formation.wire import Outgoing
from tests.support.fleet import at
from tests.unit.leader.leading import CURVED, Said, arriving, ask, positions, relayed, status

TERM = int(1.6e9 * 1e9)


@pytest.fixture
def stood() -> Mission:
    """With two standbys: one follower's vote is a majority."""
    return parse(CURVED.replace("[shapes.line]", "[standbys.cat]\n[standbys.dan]\n[shapes.line]"))


def elected(leader: Leader, mono: float, newest: Order | None = None) -> tuple[float, list[Outgoing]]:
    """Let bob vote for this candidate, and relay this order; when it led, and what it said then."""
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
                received = order.decode(Ballot, decode(Text, out.payload).text.encode())
        mono += 0.02
    raise AssertionError("nobody was elected")


def test_every_candidate_takes_what_changes_motion_and_only_the_leader_more(stood: Mission) -> None:
    standby = Leader(stood, "cat")
    newest = Order(term=TERM, beat=9, mode="run", shape="line")  # of rank 0: ann's
    assert newest.term % 64 == 0
    standby.step(at(0.0), [])
    standby.step(at(0.1), [arriving(relayed("bob", newest, voted_term=TERM, last_ballot=1, of=stood), 0.1)])
    reply = ask(standby, b'{"do":"shape","shape":"near"}')
    assert (reply.ok, reply.leads, reply.reason) == (False, False, "stands by; ann leads")
    for do, mode in (("run", "run"), ("hold", "hold"), ("stop", "stop"), ("release", "hold"), ("run", "run")):
        reply = ask(standby, do)
        assert (reply.robot, reply.ok, reply.leads, reply.mode) == ("cat", True, False, mode)


def test_a_candidate_that_has_just_started_takes_stop_and_hold_only(stood: Mission) -> None:
    leader = Leader(stood)
    leader.step(at(0.0), [])
    assert ask(leader, "run").reason == "has just started: ask again in a second"
    assert ask(leader, "hold").ok
    assert ask(leader, "stop").ok


@pytest.mark.parametrize(("mine", "others"), [("hold", "run"), ("run", "hold")])
def test_leader_that_lost_its_lease_keeps_any_hold(
    stood: Mission, mine: str, others: Literal["hold", "run"]
) -> None:
    leader = Leader(stood)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, mine).ok
    for k in range(1, 60):
        leader.step(at(mono + k / 50), [])
    assert not leader.leads
    said = Order(term=leader.term + 1, beat=9, mode=others, shape="line", base_mode=others, time=1.0)
    elected(leader, mono + 5.0, said)
    assert leader.mode == "hold"
    assert ask(leader, "run").mode == "run"


def test_a_standby_that_was_stopped_leads_a_team_that_is_stopped(stood: Mission) -> None:
    standby = Leader(stood, "cat")
    standby.step(at(0.0), [])
    ask(standby, "stop")
    newest = Order(term=TERM, beat=9, mode="run", shape="line", time=3.0)
    mono, outbox = elected(standby, 1.0, newest)
    (result,) = positions(mono, outbox)
    assert result.order.mode == "stop"
    assert (result.order.base_mode, result.order.time) == ("run", 3.0)
    assert ask(standby, "release").mode == "hold"
    assert ask(standby, "run").mode == "run"


def test_leading_standby_has_its_own_publisher_id(stood: Mission) -> None:
    standby = Leader(stood, "cat", publisher_id="cats")
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
    # without votes its lease ends, and it speaks no more
    said_at = [k / 50 for k in range(1, 100) if positions(0.0, standby.step(at(mono + k / 50), []))]
    assert not standby.leads
    assert 0.3 < max(said_at) < 0.5 * stood.takeover
    mono, outbox = elected(standby, mono + 5.0, newest)
    (again,) = positions(mono, outbox)
    assert again.publisher_id not in {"", "cats"}
    assert again.order.beat == 1


def sent_north(stood: Mission) -> tuple[Said, Outgoing]:
    """What a leader says last that was told to drive north: where it is, and its route."""
    leader = Leader(stood)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}').ok
    outbox = leader.step(at(mono + 0.01), [])
    (last,) = positions(mono, outbox)
    (reported,) = (out for out in outbox if out.key == ROUTE.key("ann"))
    return last, reported


def test_a_standby_goes_on_along_the_route_that_it_received(stood: Mission) -> None:
    last, reported = sent_north(stood)
    standby = Leader(stood, "cat")
    standby.step(at(0.0), [])
    standby.step(at(0.1), [arriving(reported, 0.1)])
    began, _ = elected(standby, 0.12, last.order)
    assert standby.mode == "run"
    assert standby.where(began) == pytest.approx(last.pose.position, abs=1e-3)
    assert standby.plan.route.id == last.order.route != ""


def test_standby_without_route_holds_until_it_arrives(stood: Mission) -> None:
    last, reported = sent_north(stood)
    standby = Leader(stood, "cat")
    began, outbox = elected(standby, 0.0, last.order)
    (result,) = positions(began, outbox)
    assert result.order.mode == "hold"
    assert result.pose.position == pytest.approx(last.pose.position, abs=1e-3)
    assert "does not know the route" in str(status("cat", outbox).reason)
    standby.step(at(began + 0.01), [arriving(reported, began + 0.01)])
    assert standby.mode == "run"
    assert standby.where(began + 0.01) == pytest.approx(last.pose.position, abs=1e-3)


def test_invalid_ballots_routes_and_positions_are_only_counted(stood: Mission) -> None:
    leader = Leader(stood)
    leader.step(at(0.0), [])
    for key in ("cat/ballot", "cat/route", "bob/position", "eve/position"):
        leader.step(at(0.1), [arriving(Outgoing(key, b"\x00\x01\x00\x00junk", b"junk"), 0.1)])
    assert leader.dropped == {"cat/ballot": 1, "cat/route": 1, "bob/position": 1, "eve/position": 1}


def test_only_listed_processes_are_candidates(stood: Mission) -> None:
    with pytest.raises(ValueError, match="ann, cat, dan"):
        Leader(stood, "bob")


def led(mission: Mission, *, readonly: bool = False, shadow: bool = False) -> list[bool]:
    """Whether ann leads, for 5 s in which bob's agent echoes its ballots, or a readonly one does so too."""
    leader, leads = Leader(mission), []
    received = Ballot(term=1, number=1, candidacy="candidate", mission=mission.tag)
    for k in range(250):
        vote: dict[str, Any] = {"voted_term": received.term, "last_ballot": received.number}
        result = [relayed("bob", None, readonly=readonly, of=mission, **vote)]
        if shadow:
            result.append(relayed("bob", None, readonly=True, publisher="shadow", of=mission))
        for out in leader.step(at(0.02 * k), [arriving(one, 0.02 * k) for one in result]):
            if out.key == BALLOT.key(leader.name):
                received = order.decode(Ballot, decode(Text, out.payload).text.encode())
        leads.append(leader.leads)
    return leads


def test_readonly_agents_do_not_end_their_robots_votes(stood: Mission) -> None:
    assert led(stood, shadow=True)[-100:] == [True] * 100


def test_readonly_agents_alone_elect_no_leader(stood: Mission) -> None:
    assert not any(led(stood, readonly=True))
