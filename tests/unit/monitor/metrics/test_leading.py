"""The candidate that leads, and the others, in metrics and events."""

from __future__ import annotations

import pytest

from formation.monitor.metrics.event import Event
from formation.monitor.metrics.keys import watched
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.orders import leader_of
from formation.monitor.metrics.words import line
from formation.protocol import json_message
from formation.protocol.attachment import Ballot
from formation.ros2.messages import Text
from formation.topics import BALLOT, POSITION, ROUTE, STATUS
from tests.support.monitored import (
    EPOCH,
    Fleet,
    Watcher,
    now,
    of,
    receive,
    received,
    sample_of,
    status,
    with_standbys,
)

FIRST, SECOND = 64 * 10, 64 * 20 + 1
"""Terms of the leader's own process, and of the first standby."""


class Team(Watcher):
    """Six robots with two standbys: processes that may lead publish their status until they are killed."""

    def __init__(self, go_on: float = 15.0) -> None:
        super().__init__(Fleet(with_standbys(), term=FIRST))
        self.alive = {"robot1": "run", "spare1": "standby", "spare2": "standby"}
        self.go_on(go_on)

    def go_on(self, until: float, *, without: str = "") -> list[Event]:
        words = [
            status(name, at / 10, state, "")
            for name, state in self.alive.items()
            for at in range(round(10 * self.at) + 1, round(10 * until), 4)
        ]
        return self.drive(until, *words, without=without)

    def fail_over(self) -> list[Event]:
        """robot1's process is killed; spare1 leads after 0.9 s."""
        del self.alive["robot1"]
        events = self.go_on(self.at + 0.9, without="robot1")
        self.fleet.term, self.alive["spare1"] = SECOND, "run"
        return events + self.go_on(self.at + 5.0)


def test_leader_is_known_by_the_term_of_orders() -> None:
    mission = with_standbys()
    assert [leader_of(mission, 640 + rank) for rank in range(4)] == ["robot1", "spare1", "spare2", ""]
    assert leader_of(Fleet().mission, 643) == "robot1"


def test_mission_without_standbys_shows_no_candidates() -> None:
    one = Watcher()
    one.drive(15.0)
    assert (one.seen.leads, one.seen.candidates) == ("robot1", {})
    assert not of(one.reported, "leader")
    assert "leads" not in line(one.seen)


def test_standby_topics_are_subscribed_with_status_last() -> None:
    mission = with_standbys()
    keys = [one.key for one in watched(mission)]
    last = min(keys.index(STATUS.key(name)) for name in mission.candidates)
    for name in mission.candidates:
        assert {BALLOT.key(name), ROUTE.key(name), STATUS.key(name)} <= set(keys)
        assert keys.index(BALLOT.key(name)) < last
    assert POSITION.key("robot1") in keys
    assert f"spare1/{POSITION.name}" not in keys


def test_leading_standby_is_reported_with_time_without_leader() -> None:
    team = Team()
    assert [(event.robot, event.text) for event in of(team.reported, "leader")] == [("robot1", "leads")]
    events = team.fail_over()
    (change,) = of(events, "leader")
    assert (change.robot, change.level) == ("spare1", 30)
    assert change.text.startswith("leads from here on, robot1 was silent for 0.9")
    (lost,) = of(events, "lost")
    assert (lost.robot, lost.level, lost.text.startswith("cannot take over")) == ("robot1", 30, True)
    seen = team.seen
    assert seen.leads == "spare1"
    assert "spare1 leads, robot1 could not" in line(seen)
    leader = seen.robots["robot1"]  # shown while any candidate leads
    assert leader.state == "run"
    assert leader.age is not None
    assert leader.age < 0.1
    assert seen.formation_error == pytest.approx(0.0, abs=1e-6)


def test_returning_leader_is_shown_as_standby() -> None:
    team = Team()
    team.fail_over()
    team.alive["robot1"] = "standby"
    (event,) = [event for event in team.go_on(25.0) if event.robot == "robot1"]
    assert event[1:] == (20, "robot1", "standby", "stands by")
    states = {name: one.state for name, one in team.seen.candidates.items()}
    assert states == {"robot1": "standby", "spare1": "leads", "spare2": "standby"}
    assert team.seen.robots["robot1"].state == "run"


def test_dead_standby_is_lost_with_warning_only() -> None:
    team = Team()
    del team.alive["spare2"]
    (lost,) = of(team.go_on(20.0), "lost")
    assert (lost.robot, lost.level) == ("spare2", 30)
    assert team.seen.candidates["spare2"].state == "silent"
    assert team.seen.converged
    assert set(team.seen.robots) == set(team.fleet.mission.names)


def test_monitor_shows_no_leader_after_the_leader_is_lost() -> None:
    team = Team()
    del team.alive["robot1"]
    events = team.go_on(18.0, without="robot1")
    assert team.seen.leads is None
    assert "no leader" in line(team.seen)
    assert [(event.robot, event.level) for event in of(events, "lost")] == [("robot1", 40)]


def test_positions_of_a_former_leader_are_rejected() -> None:
    team = Team()
    team.fail_over()
    metrics, at = team.monitor.metrics, team.at
    former = Fleet(team.fleet.mission, term=FIRST, away=lambda *_: 5.0 + 0j, beat=1000)
    receive(metrics, [former.position("robot1", at + 0.01)])
    for time in (at + 0.02, at + 0.05):
        receive(metrics, [team.fleet.position(name, time) for name in team.fleet.mission.names])
    snapshot = metrics.snapshot(now(at + 0.05))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-6)
    assert snapshot.leads == "spare1"
    assert list(snapshot.rejected) == ["robot1/position: of an earlier term: another leads by now"]


def test_new_leader_with_slow_clock_is_shown_soon() -> None:
    fleet = Fleet(with_standbys(), term=FIRST)
    metrics = received(fleet, *fleet.positions(10.0, 12.0))
    fleet.term = SECOND
    later = fleet.positions(12.9, 13.5, without="robot1")
    later += [fleet.position("robot1", time, clock=-5.0) for time in fleet.times("robot1", 12.9, 13.5)]
    receive(metrics, sorted(later, key=lambda sample: sample.arrived))
    snapshot = metrics.snapshot(now(13.5))
    assert snapshot.leads == "spare1"
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-3)
    assert not snapshot.rejected


def test_order_with_far_future_term_is_ignored() -> None:
    fleet = Fleet(with_standbys(), term=int((EPOCH + 2e5) * 1e9))
    assert received(fleet, fleet.position("robot1", 10.0)).orders.newest is None


def test_invalid_ballots_are_rejected_and_counted() -> None:
    metrics = Metrics(with_standbys())
    good = Ballot(term=SECOND, number=1, candidacy="candidate", mission=with_standbys().tag)
    ballot = Text(json_message.encode(good).decode())
    receive(metrics, [sample_of(BALLOT.key("spare1"), ballot, 10.0)])
    assert not metrics.rejections.by_reason
    bad = {"spare2": ballot, "robot1": Text("{}")}
    receive(metrics, [sample_of(BALLOT.key(name), text, 10.1) for name, text in bad.items()])
    assert metrics.rejections.by_key == {BALLOT.key(name): 1 for name in bad}
