"""Rules of true positions: what breaks them is found."""

from __future__ import annotations

from typing import Any

import pytest

from formation.agent.watchdog.core import Watchdog
from formation.deploy.rehearsal.faults import parse
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, run
from formation.deploy.rehearsal.rules import places
from formation.deploy.rehearsal.rules.places import room
from formation.leader.candidacy import Candidacy
from formation.leader.plan import Plan as LeaderPlan
from formation.mission.file import load
from tests.campaigns.defects.plan import MISSIONS

PAIR, POSTS, PATROL, FENCED = (
    load("turtlebot3_pair"),
    load("posts"),
    load("patrol"),
    load(MISSIONS / "fenced.toml"),
)


def rehearsed(mission: Any, *faults: str, seconds: float = 0.0) -> Verdict:
    return run(Plan(mission, seconds=seconds), 0, tuple(parse(one, mission) for one in faults))


def test_robot_that_drives_without_agent_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert rehearsed(PAIR, "robot1:kill@5+4").violations == ()
    monkeypatch.setattr(Watchdog, "_silent", lambda *_: False)
    assert "watchdog" in rehearsed(PAIR, "robot1:kill@5+4").broken
    assert "watchdog" in rehearsed(PAIR, "robot1:freeze@5+4").broken


def test_robot_that_leaves_bounds_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert rehearsed(FENCED, seconds=20.0).violations == ()
    monkeypatch.setattr(LeaderPlan, "_fenced", lambda *_: None)
    monkeypatch.setattr("formation.agent.core.Geofence.outside", lambda *_, before: None)  # noqa: ARG005
    monkeypatch.setattr("formation.agent.following.orders.Geofence.check", lambda *_: None)
    monkeypatch.setattr("formation.agent.inbox.Geofence.holds", lambda *_: True)
    assert "bounds" in rehearsed(FENCED, seconds=20.0).broken


def test_distance_to_posts_and_walls() -> None:
    assert room(PAIR, 0j) == float("inf")
    assert room(POSTS, 1.6 + 0.55j) == pytest.approx(-0.12)
    assert room(POSTS, 1.6 + 1.55j) == pytest.approx(0.88)
    assert room(POSTS, 3.4 - 2.2j) == pytest.approx(1.0)


def test_body_in_a_post_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "room", lambda *_: 0.05)
    (first, *_) = rehearsed(POSTS).violations
    assert first.rule == "touch"
    assert "what it sees" in first.what


def test_orders_of_a_leader_that_was_replaced_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """It leads on without votes, and counts as no leader by its lease."""
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


def test_leader_that_drives_while_its_team_rests_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert rehearsed(PAIR, "robot1:hold@5+3").violations == ()
    honest = LeaderPlan.go_on
    monkeypatch.setattr(LeaderPlan, "go_on", lambda plan, mono, dt, _: honest(plan, mono, dt, "run"))
    assert "zero" in rehearsed(PAIR, "robot1:hold@5+3").broken
