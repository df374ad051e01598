"""Parts of the rules of a rehearsal, and messages that tell two cases of a rule apart."""

from __future__ import annotations

from typing import Any

import pytest

from formation.agent.core import Agent
from formation.deploy.rehearsal import rehearsal
from formation.deploy.rehearsal.faults import Restarted
from formation.deploy.rehearsal.rules import places, settling
from formation.deploy.rehearsal.rules.places import room
from formation.deploy.rehearsal.rules.received import Newest, OrdersReceived
from formation.leader.candidacy import Candidacy
from formation.ros2.messages import Odometry, decode, encode
from formation.wire import Outgoing
from tests.unit.deploy.rehearsal.test_safeguards import ORDER, PAIR, PATROL, POSTS, rehearsed


def test_room_is_distance_to_posts_and_walls() -> None:
    assert room(PAIR, 0j) == float("inf")
    assert room(POSTS, 1.6 + 0.55j) == pytest.approx(-0.12)
    assert room(POSTS, 1.6 + 1.55j) == pytest.approx(0.88)
    assert room(POSTS, 3.4 - 2.2j) == pytest.approx(1.0)


def test_touch_rule_detects_body_inside_a_post(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "room", lambda *_: 0.05)
    (first, *_) = rehearsed(POSTS).violations
    assert first.rule == "touch"
    assert "what it sees" in first.what


def test_leaders_rule_detects_orders_of_replaced_leader(monkeypatch: pytest.MonkeyPatch) -> None:
    """The replaced leader goes on giving orders after its lease has ended."""
    honest = Candidacy.step

    def step(candidacy: Candidacy, *given: Any) -> Any:
        leading, before = candidacy.leading, candidacy.term
        ballot = honest(candidacy, *given)
        if leading and candidacy.term == before:
            candidacy.state = "leader"
        return ballot

    monkeypatch.setattr(Candidacy, "step", step)
    found = rehearsed(PATROL, "leader:cut@5+6").violations
    assert any(one.rule == "leaders" and "after which another" in one.what for one in found)


def test_exception_rule_names_process_and_error(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = Agent.act

    def fail(agent: Agent, now: Any, inbox: Any) -> list[Outgoing]:
        if agent.robot == "robot2" and now.mono > 1003.0:
            raise ZeroDivisionError("of today")
        return honest(agent, now, inbox)

    monkeypatch.setattr(Agent, "act", fail)
    (violation,) = [one for one in rehearsed(PAIR).violations if one.rule == "exception"]
    assert violation.robot == "agent robot2"
    assert violation.what == "ZeroDivisionError: of today"


def test_formation_rule_detects_unsettled_formation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "START_TIME", 3.0)
    monkeypatch.setattr(settling, "RECOVERY_TIME", 2.0)
    found = rehearsed(PAIR.changed(settled=-1.0), "robot2:full@1+1").violations
    (violation,) = [one for one in found if one.rule == "formation"]
    assert "robot2: " in violation.what


def test_orders_count_only_after_their_beat_rises() -> None:
    received, later = OrdersReceived(), ORDER.model_copy(update={"beat": 8})
    received.add("robot1/position", ORDER, 1.0)
    received.add("robot1/position", ORDER, 2.0)
    received.add("robot2/position", later, 3.0)
    assert received.risen == set()
    received.add("robot1/position", later, 4.0)
    assert (received.risen, received.rose) == ({64}, 4.0)


def test_quickest_delay_of_messages_expires() -> None:
    newest = Newest().after(1.0, 1.1).after(2.0, 2.5)
    assert (newest.sent, newest.quickest) == pytest.approx((2.0, 0.1))
    assert newest.after(80.0, 80.5).quickest == pytest.approx(0.5)


def test_restarted_odometry_counts_from_zero() -> None:
    restarted = Restarted()
    first = decode(Odometry, restarted.changed(encode(Odometry(1.0, 2 + 1j, 1j, 0.1, 0.0))))
    later = decode(Odometry, restarted.changed(encode(Odometry(2.0, 2 + 3j, -1 + 0j, 0.1, 0.0))))
    assert first.position == pytest.approx(0j)
    assert later.position == pytest.approx(2 + 0j)
    assert later.heading == pytest.approx(1j)
