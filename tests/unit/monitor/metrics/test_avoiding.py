"""Robots that avoid others, are slowed, blocked or kept from moving: in metrics, events and reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from formation.control.zones import Zone
from formation.monitor.metrics.events import CLEAR_TIME
from formation.monitor.metrics.words import as_json, diagnostics
from formation.monitor.report import tables
from formation.protocol.status import CollisionMode
from formation.ros2.messages import Diagnostics, Status
from formation.topics import STATUS
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, now, sample_of, status
from tests.support.recordings import gathered, record, talk
from tests.unit.monitor.metrics.test_events import Watcher, of

CLEAR: dict[str, Any] = {"collisions": CollisionMode.ON, "zone": Zone.CLEAR}
AVOIDS = {**CLEAR, "avoiding": True}


def values(at: float, more: dict[str, Any], state: str = "run") -> Sample:
    return status("robot4", at, state, **more)


@pytest.mark.parametrize(
    ("words", "does"),
    [
        (CLEAR, ""),
        (AVOIDS, "avoids"),
        ({**AVOIDS, "zone": Zone.SLOW}, "slowed"),
        ({**AVOIDS, "zone": Zone.STOP}, "blocked"),
        ({"zone": Zone.STOP}, "blocked"),
        ({"collisions": CollisionMode.WARN, "avoiding": True}, ""),
        ({}, ""),
    ],
)
def test_status_tells_why_robot_deviates_from_law(words: dict[str, Any], does: str) -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, words))
    assert one.monitor.metrics.snapshot(now(12.0)).robots["robot4"].avoiding == does


def test_robot_that_does_not_run_avoids_nothing() -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, {"zone": Zone.STOP}, state="hold"))
    assert one.monitor.metrics.snapshot(now(12.0)).robots["robot4"].avoiding == ""


@pytest.mark.parametrize(
    ("text", "count"), [("3", 3), ("0", 0), ("-1", 0), ("many", 0), ("9" * 400, 0), ("x³", 0)]
)
def test_deadlocks_are_counted_and_damaged_counts_rejected(text: str, count: int) -> None:
    one = Watcher(Fleet())
    what = {"kind": "agent", "robot": "robot4", "state": "run", "reason": "running", "deadlocks": text}
    message = Diagnostics(11.5 + EPOCH, (Status("", 0, "", "", what),))
    one.drive(12.0, sample_of(STATUS.key("robot4"), message, 11.5))
    snapshot = one.monitor.metrics.snapshot(now(12.0))
    assert snapshot.robots["robot4"].deadlocks == count
    assert as_json(snapshot)["robots"]["robot4"]["deadlocks"] == count


def test_it_is_in_what_ros_tools_see() -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, {"zone": Zone.SLOW, "deadlocks": 2}))
    snapshot = one.monitor.metrics.snapshot(now(12.0))
    (reported,) = (
        status.values
        for message in diagnostics(snapshot, 12.0)
        for status in message.statuses
        if status.name == "robot4: monitor"
    )
    assert (reported["avoiding"], reported["deadlocks"]) == ("slowed", "2")


def test_events_report_avoiding_blocked_and_finally_clear() -> None:
    one = Watcher(Fleet())
    words = {
        11.0: CLEAR,
        11.5: AVOIDS,
        12.0: CLEAR,
        12.5: AVOIDS,
        13.0: {"zone": Zone.STOP},
        13.5: CLEAR,
    }
    samples = [values(at, each) for at, each in words.items()]
    samples += [values(14.0 + n / 2, CLEAR) for n in range(6)]
    reported = one.drive(14.0 + CLEAR_TIME, *samples)
    assert [(event.kind, event.level, event.text) for event in reported if event.robot == "robot4"][-3:] == [
        ("avoiding", 20, "avoids a collision"),
        ("blocked", 30, "stopped by its protective zone"),
        ("clear", 20, "no obstacle limits its command any more"),
    ]
    assert len(of(reported, "avoiding")) == 1


def test_every_deadlock_is_told_with_their_number() -> None:
    one = Watcher(Fleet())
    samples = [values(11.0 + n / 2, {"deadlocks": count}) for n, count in enumerate((0, 1, 1, 2, 0))]
    reported = [event.text for event in of(one.drive(14.0, *samples), "deadlock")]
    assert reported == [f"kept from moving, it goes another way ({count} so far)" for count in (1, 2)]


def test_a_report_says_for_how_long_and_how_often(tmp_path: Path) -> None:
    words = {
        10.0: AVOIDS,
        11.0: {"zone": Zone.STOP, "deadlocks": 1},
        12.5: {**CLEAR, "deadlocks": 1},
    }
    samples = [one for one in talk(Fleet(), 4.0) if one.key != STATUS.key("robot4")]
    held = {at: max(since for since in words if since <= at) for at in (10.0 + n / 2 for n in range(8))}
    samples += [values(at, words[since]) for at, since in held.items()]
    record(tmp_path / "run.mcap", sorted(samples, key=lambda one: one.arrived))
    run = gathered(tmp_path / "run.mcap")
    did = run.doings["robot4"]
    assert did.avoiding == pytest.approx(1.0, abs=0.4)
    assert did.blocked == pytest.approx(1.5, abs=0.4)
    assert did.deadlocks == 1
    table = tables.doings(run)
    (row,) = (row for row in table.rows if row[0] == "robot4")
    assert row[table.heads.index("deadlocks")] == "1"
    assert {"avoiding", "blocked"} <= set(table.heads)
