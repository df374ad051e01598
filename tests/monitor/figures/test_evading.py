"""Who gets out of the way, is slowed, blocked or kept from moving: in figures, events and reports."""

from __future__ import annotations

from pathlib import Path

import pytest

from formation.ros2.messages import Diagnostics, Status
from formation.topics import STATUS
from formation.wire import Sample
from monitor.figures.events import CLEAR_FOR
from monitor.figures.words import as_json, diagnostics
from monitor.report import happened
from tests.monitor.figures.test_events import Watcher, of
from tests.monitor.fleet import EPOCH, Fleet, now, said
from tests.monitor.report.recordings import gathered, record, talk

YIELDS = {"collisions": "on: gets out of the way", "protective zone": "clear"}
CLEAR = {"collisions": "on: clear", "protective zone": "clear"}


def values(at: float, words: dict[str, str], state: str = "run") -> Sample:
    what = Status("robot4: agent", 0, "run", "robot4", {"state": state, "reason": "", **words})
    return said(STATUS.key("robot4"), Diagnostics(at + EPOCH, (what,)), at)


@pytest.mark.parametrize(
    ("words", "does"),
    [
        (CLEAR, ""),
        (YIELDS, "yields"),
        ({**YIELDS, "protective zone": "slow"}, "slowed"),
        ({**YIELDS, "protective zone": "stop"}, "blocked"),
        ({"protective zone": "stop"}, "blocked"),
        ({"collisions": "warn: would get out of the way"}, ""),
        ({"protective zone": "somewhere"}, ""),
        ({}, ""),
    ],
)
def test_what_keeps_a_robot_from_doing_as_its_law_wants_is_known_by_its_status(
    words: dict[str, str], does: str
) -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, words))
    assert one.monitor.metrics.snapshot(now(12.0)).robots["robot4"].evades == does


def test_who_does_not_run_evades_nothing() -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, {"protective zone": "stop"}, state="hold"))
    assert one.monitor.metrics.snapshot(now(12.0)).robots["robot4"].evades == ""


@pytest.mark.parametrize(
    ("text", "count"), [("3", 3), ("0", 0), ("-1", 0), ("many", 0), ("9" * 400, 0), ("³", 0)]
)
def test_deadlocks_are_counted_and_what_is_no_count_is_none(text: str, count: int) -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, {"deadlocks": text}))
    snapshot = one.monitor.metrics.snapshot(now(12.0))
    assert snapshot.robots["robot4"].deadlocks == count
    assert as_json(snapshot)["robots"]["robot4"]["deadlocks"] == count


def test_it_is_in_what_ros_tools_see() -> None:
    one = Watcher(Fleet())
    one.drive(12.0, values(11.5, {"protective zone": "slow", "deadlocks": "2"}))
    snapshot = one.monitor.metrics.snapshot(now(12.0))
    (told,) = (
        status.values
        for message in diagnostics(snapshot, 12.0)
        for status in message.statuses
        if status.name == "robot4: monitor"
    )
    assert (told["evades"], told["deadlocks"]) == ("slowed by its protective zone", "2")


def test_it_is_told_when_a_robot_gets_out_of_the_way_is_blocked_and_its_way_is_clear_for_good() -> None:
    one = Watcher(Fleet())
    words = {
        11.0: CLEAR,
        11.5: YIELDS,
        12.0: CLEAR,
        12.5: YIELDS,
        13.0: {"protective zone": "stop"},
        13.5: CLEAR,
    }
    samples = [values(at, each) for at, each in words.items()]
    samples += [values(14.0 + n / 2, CLEAR) for n in range(6)]
    told = one.drive(14.0 + CLEAR_FOR, *samples)
    assert [(event.kind, event.level, event.text) for event in told if event.robot == "robot4"][-3:] == [
        ("evades", 20, "gets out of the way"),
        ("blocked", 30, "stopped by its protective zone"),
        ("clear", 20, "its way is clear again"),
    ]
    assert len(of(told, "evades")) == 1


def test_every_deadlock_is_told_with_their_number() -> None:
    one = Watcher(Fleet())
    samples = [values(11.0 + n / 2, {"deadlocks": str(count)}) for n, count in enumerate((0, 1, 1, 2, 0))]
    told = [event.text for event in of(one.drive(14.0, *samples), "deadlock")]
    assert told == [f"kept from moving, it goes another way ({count} so far)" for count in (1, 2)]


def test_a_report_says_for_how_long_and_how_often(tmp_path: Path) -> None:
    words = {
        10.0: YIELDS,
        11.0: {"protective zone": "stop", "deadlocks": "1"},
        12.5: {**CLEAR, "deadlocks": "1"},
    }
    samples = [one for one in talk(Fleet(), 4.0) if one.key != STATUS.key("robot4")]
    held = {at: max(since for since in words if since <= at) for at in (10.0 + n / 2 for n in range(8))}
    samples += [values(at, words[since]) for at, since in held.items()]
    record(tmp_path / "run.mcap", sorted(samples, key=lambda one: one.arrived))
    run = gathered(tmp_path / "run.mcap")
    did = run.doings["robot4"]
    assert did.evading == pytest.approx(1.0, abs=0.4)
    assert did.blocked == pytest.approx(1.5, abs=0.4)
    assert did.deadlocks == 1
    table = happened.doings(run)
    (row,) = (row for row in table.rows if row[0] == "robot4")
    assert row[table.heads.index("deadlocks")] == "1"
    assert {"out of the way", "blocked"} <= set(table.heads)
