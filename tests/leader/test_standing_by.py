"""Candidates: who stands by says so, and goes on from what the robots relay when it is elected."""

from __future__ import annotations

import pytest

from formation import order
from formation.mission import Mission
from formation.mission_file import parse
from formation.order import Ballot, Order
from formation.ros2.messages import Text, decode
from formation.topics import BALLOT, COURSE
from formation.wire import Outgoing
from leader.core import Leader
from tests.leader.leading import (
    CURVED,
    Said,
    arriving,
    ask,
    at,
    positions,
    relayed,
    status,
)

TERM = int(1.6e9 * 1e9)


@pytest.fixture
def stood() -> Mission:
    """With two standbys: one follower's voice is a majority."""
    return parse(CURVED.replace("[shapes.line]", "[standbys.cat]\n[standbys.dan]\n[shapes.line]"))


def elected(leader: Leader, mono: float, newest: Order | None = None) -> tuple[float, list[Outgoing]]:
    """Let bob give this candidate his voice, and relay this order; when it led, and what it said then."""
    heard = Ballot(term=1, number=1, standing="candidate", mission=leader._mission.tag)
    for _ in range(300):
        told = relayed("bob", newest, promise=heard.term, echo=heard.number, of=leader._mission)
        outbox = leader.step(at(mono), [arriving(told, mono)])
        if leader.leads:
            return mono, outbox
        for out in outbox:
            if out.key == BALLOT.key(leader.name):
                heard = order.decode(Ballot, decode(Text, out.payload).text.encode())
        mono += 0.02
    raise AssertionError("nobody was elected")


def test_every_candidate_takes_what_changes_motion_and_only_the_leader_more(stood: Mission) -> None:
    standby = Leader(stood, "cat")
    newest = Order(term=TERM, beat=9, mode="run", shape="line")  # of rank 0: ann's
    assert newest.term % 64 == 0
    standby.step(at(0.0), [])
    standby.step(at(0.1), [arriving(relayed("bob", newest, promise=TERM, echo=1, of=stood), 0.1)])
    reply = ask(standby, b'{"do":"shape","shape":"near"}')
    assert (reply.ok, reply.leads, reply.reason) == (False, False, "stands by; ann leads")
    for do, mode in (("run", "run"), ("hold", "hold"), ("stop", "stop"), ("release", "hold"), ("run", "run")):
        reply = ask(standby, f'{{"do":"{do}"}}'.encode())
        assert (reply.robot, reply.ok, reply.leads, reply.mode) == ("cat", True, False, mode)


def test_a_candidate_that_has_just_started_takes_stop_and_hold_only(stood: Mission) -> None:
    leader = Leader(stood)
    leader.step(at(0.0), [])
    assert ask(leader, b'{"do":"run"}').reason == "has just started: ask again in a second"
    assert ask(leader, b'{"do":"hold"}').ok
    assert ask(leader, b'{"do":"stop"}').ok


def test_a_leader_that_lost_its_lease_keeps_its_hold(stood: Mission) -> None:
    leader = Leader(stood)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, b'{"do":"hold"}').ok
    for k in range(1, 60):
        leader.step(at(mono + k / 50), [])
    assert not leader.leads
    running = Order(term=leader.term + 1, beat=9, mode="run", shape="line", time=1.0)
    elected(leader, mono + 5.0, running)
    assert leader.mode == "hold"
    assert ask(leader, b'{"do":"run"}').mode == "run"


def test_a_leader_that_led_before_restores_what_others_were_told(stood: Mission) -> None:
    leader = Leader(stood)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, b'{"do":"run"}').ok
    for k in range(1, 60):
        leader.step(at(mono + k / 50), [])
    assert not leader.leads
    held = Order(term=leader.term + 1, beat=9, mode="hold", shape="line", told="hold", time=1.0)
    elected(leader, mono + 5.0, held)
    assert leader.mode == "hold"


def test_a_standby_that_was_stopped_leads_a_team_that_is_stopped(stood: Mission) -> None:
    standby = Leader(stood, "cat")
    standby.step(at(0.0), [])
    ask(standby, b'{"do":"stop"}')
    newest = Order(term=TERM, beat=9, mode="run", shape="line", time=3.0)
    mono, outbox = elected(standby, 1.0, newest)
    (said,) = positions(mono, outbox)
    assert said.order.mode == "stop"
    assert (said.order.told, said.order.time) == ("run", 3.0)
    assert ask(standby, b'{"do":"release"}').mode == "hold"
    assert ask(standby, b'{"do":"run"}').mode == "run"


def test_a_standby_goes_on_under_the_leaders_name_with_a_voice_of_its_own(stood: Mission) -> None:
    standby = Leader(stood, "cat", voice="cats")
    assert set(standby.subscriptions) == {
        "bob/position", "ann/ballot", "dan/ballot", "ann/course", "dan/course"
    }  # fmt: skip
    assert {key for _, key in standby.publications} == {
        "ann/position", "cat/status", "cat/ballot", "cat/course"
    }  # fmt: skip
    newest = Order(term=TERM, beat=9, mode="run", shape="near", time=3.0, told="run", holding=True)
    mono, outbox = elected(standby, 0.0, newest)
    (said,) = positions(mono, outbox)
    assert (said.voice, said.order.time, said.order.mode) == ("cats", 3.0, "hold")
    assert said.order.term % 64 == 1
    assert status("cat", outbox)["leads"] == "yes"
    # without echoes its lease ends, and it speaks no more
    said_at = [k / 50 for k in range(1, 100) if positions(0.0, standby.step(at(mono + k / 50), []))]
    assert not standby.leads
    assert 0.3 < max(said_at) < 0.5 * stood.takeover
    mono, outbox = elected(standby, mono + 5.0, newest)
    (again,) = positions(mono, outbox)
    assert again.voice not in {"", "cats"}
    assert again.order.beat == 1


def sent_north(stood: Mission) -> tuple[Said, Outgoing]:
    """What a leader says last that was told to drive north: where it is, and its course."""
    leader = Leader(stood)
    mono, _ = elected(leader, 0.0)
    assert ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}').ok
    outbox = leader.step(at(mono + 0.01), [])
    (last,) = positions(mono, outbox)
    (told,) = (out for out in outbox if out.key == COURSE.key("ann"))
    return last, told


def test_a_standby_goes_on_along_the_course_that_it_was_told(stood: Mission) -> None:
    last, told = sent_north(stood)
    standby = Leader(stood, "cat")
    standby.step(at(0.0), [])
    standby.step(at(0.1), [arriving(told, 0.1)])
    began, _ = elected(standby, 0.12, last.order)
    assert standby.mode == "run"
    assert standby.where(began) == pytest.approx(last.pose.position, abs=1e-3)
    assert standby.conduct.course.id == last.order.route != ""


def test_a_standby_that_does_not_know_the_course_stands_there_until_it_does(stood: Mission) -> None:
    last, told = sent_north(stood)
    standby = Leader(stood, "cat")
    began, outbox = elected(standby, 0.0, last.order)
    (said,) = positions(began, outbox)
    assert said.order.mode == "hold"
    assert said.pose.position == pytest.approx(last.pose.position, abs=1e-3)
    assert "does not know the route" in status("cat", outbox)["reason"]
    standby.step(at(began + 0.01), [arriving(told, began + 0.01)])
    assert standby.mode == "run"
    assert standby.where(began + 0.01) == pytest.approx(last.pose.position, abs=1e-3)


def test_what_is_no_ballot_course_or_position_is_counted_and_harms_nobody(stood: Mission) -> None:
    leader = Leader(stood)
    leader.step(at(0.0), [])
    for key in ("cat/ballot", "cat/course", "bob/position", "eve/position"):
        leader.step(at(0.1), [arriving(Outgoing(key, b"\x00\x01\x00\x00junk", b"junk"), 0.1)])
    assert leader.dropped == {"cat/ballot": 1, "cat/course": 1, "bob/position": 1, "eve/position": 1}


def test_nobody_is_a_candidate_whom_the_mission_does_not_list(stood: Mission) -> None:
    with pytest.raises(ValueError, match="ann, cat, dan"):
        Leader(stood, "bob")
