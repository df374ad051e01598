"""Events: what the monitor reports of robots, orders, rejections and the formation."""

from __future__ import annotations

import json
import math
import re
from collections import ChainMap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from formation.control.zones import Zone
from formation.mission.file import parse, read
from formation.monitor.core import Monitor
from formation.monitor.metrics.event import Event, clock_step, from_message, to_message
from formation.monitor.metrics.events import (
    CLEAR_TIME,
    LOST_SILENCE,
    MAX_REJECTION_KINDS,
    REJECTION_PERIOD,
    START_TIME,
    STATES,
    Events,
)
from formation.monitor.metrics.words import as_json, diagnostics, line
from formation.monitor.report import tables
from formation.monitor.web import routes
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Slots
from formation.protocol.status import CollisionMode, MotionFault, Sight
from formation.ros2.messages import Diagnostics, LogEntry, Status, decode, encode
from formation.topics import EVENTS, POSITION, STATUS
from formation.wire import Sample
from tests.support.monitored import (
    EPOCH,
    Fleet,
    Watcher,
    command,
    now,
    of,
    received,
    sample_of,
    status,
    with_standbys,
)
from tests.support.recordings import run_of, talk


def test_each_robot_joins_once() -> None:
    one = Watcher()
    joined = of(one.drive(20.0), "joined")
    assert [(event.robot, event.level) for event in joined] == [
        (name, 20) for name in one.fleet.mission.names
    ]
    assert joined[0].at == pytest.approx(10.1 + EPOCH, abs=0.1)


@pytest.mark.parametrize(
    ("state", "reason", "level"), [("run", "in formation control", 40), ("stop", "SIGTERM", 30)]
)
def test_silent_robot_is_lost_within_1_2_seconds(state: str, reason: str, level: int) -> None:
    """After state stop, that is only a warning."""
    one = Watcher()
    one.drive(15.0, status("robot3", 14.9, state, reason))
    (lost,) = of(one.drive(18.0, without="robot3"), "lost")
    assert LOST_SILENCE < lost.at - EPOCH - max(one.fleet.times("robot3", 10.0, 15.0)) <= 1.2
    assert (lost.robot, lost.level) == ("robot3", level)
    assert lost.text.startswith("silent for 1.")
    assert lost.text.endswith(f"last state: {state}")


def test_back_event_gives_duration_of_silence() -> None:
    one = Watcher()
    one.drive(15.0)
    one.drive(20.0, without="robot3")
    assert [event[1:] for event in of(one.drive(21.0), "back", "joined")] == [
        (20, "robot3", "back", "after 5.1 s of silence")
    ]


def test_robot_never_received_is_not_lost() -> None:
    events = Watcher().drive(20.0, without="robot5")
    assert not of(events, "lost")
    assert "robot5" not in {event.robot for event in of(events, "joined")}


def test_robot_with_a_low_rate_is_lost_later() -> None:
    text, name = read("six_robots")
    one = Watcher(Fleet(parse(text.replace("rate = 20", "rate = 1", 1), name)))
    assert not of(one.drive(30.0), "lost")
    (lost,) = of(one.drive(40.0, without="robot3"), "lost")
    assert 3.0 < lost.at - EPOCH - max(one.fleet.times("robot3", 10.0, 30.0)) <= 4.2


RUNS, RUNNING = ("run", "in formation control"), ("runs", 20, "in formation control")
NO_ORDER = ("waiting", "no order from the leader yet")


@pytest.mark.parametrize(
    ("states", "reported"),
    [
        (
            [
                NO_ORDER, RUNS, RUNS, ("hold", "odometry silent for 0.20 s"),
                ("hold", "odometry silent for 0.70 s"), ("stop", "stopped by the operator"), RUNS,
            ],
            [
                ("waiting", 20, NO_ORDER[1]), RUNNING, ("held", 30, "odometry silent for 0.20 s"),
                ("stopped", 30, "stopped by the operator"), RUNNING,
            ],
        ),
        (
            [
                ("hold", "no link to the robot"), ("waiting", "no odometry yet"),
                ("hold", "no two odometry messages within 0.15 s"), NO_ORDER, RUNS,
            ],
            [("waiting", 20, "no odometry yet"), RUNNING],
        ),
    ],
    ids=["changes", "healthy start"],
)  # fmt: skip
def test_state_changes_are_events(
    states: list[tuple[str, str]], reported: list[tuple[str, int, str]]
) -> None:
    samples = [status("robot2", 10.5 + i / 2, *words) for i, words in enumerate(states)]
    events = Watcher().drive(15.0, *samples)
    found = [(event.kind, event.level, event.text) for event in events if event.robot == "robot2"]
    assert found[1:] == reported  # after "joined"


def test_robot_that_cannot_start_causes_a_warning() -> None:
    samples = [status("robot2", 10.5 + i / 2, "hold", "no link to the robot") for i in range(20)]
    (held,) = of(Watcher().drive(20.0, *samples), "held")
    assert (held.robot, held.level, held.text) == ("robot2", 30, "no link to the robot")
    assert held.at - EPOCH - 10.5 == pytest.approx(START_TIME, abs=0.3)


def test_silent_status_creates_no_event() -> None:
    one = Watcher()
    one.drive(12.0, status("robot2", 10.5, "run", "fine"))
    assert not [event for event in one.drive(20.0) if event.robot == "robot2"]
    assert not [event for event in one.drive(21.0, status("robot2", 20.2, "run", "fine")) if event.robot]


def astray(is_off: Callable[[float], bool], by: float) -> Watcher:
    """A fleet with robot6, which has two edges, `by` [m] off its slot while `is_off` [s]."""
    return Watcher(Fleet(away=lambda robot, t: by * 1j if robot == "robot6" and is_off(t) else 0j))


def test_brief_error_above_the_bound_causes_no_unsettled_event() -> None:
    one = astray(lambda t: t % 3.0 < 0.15 and t > 15.0, 0.06)
    (settled,) = of(one.drive(30.0), "settled", "unsettled")
    assert settled.at - EPOCH == pytest.approx(12.1, abs=0.2)
    assert settled[1:] == (20, "", "settled", "under the bound of 50 mm since 0.0 s")


def test_settled_event_omits_an_unknown_time() -> None:
    one = Watcher()
    one.drive(12.0)
    touching = replace(one.seen, converged=True, settled_at=None)
    events = Events(one.fleet.mission)
    reported = [
        each for step in range(200) for each in events.collect_events(now(20.0 + step / 50), touching)
    ]
    assert [event.text for event in of(reported, "settled")] == ["under the bound of 50 mm"]


def test_large_error_is_reported_as_unsettled_then_settled() -> None:
    _, unsettled, again = of(astray(lambda t: 15.0 < t < 20.0, 0.3).drive(25.0), "settled", "unsettled")
    assert unsettled.at - EPOCH == pytest.approx(16.1, abs=0.2)
    assert unsettled[1:] == (30, "", "unsettled", "error 600 mm, bound 50 mm")
    assert again.kind == "settled"


@pytest.mark.slow
def test_oscillating_error_is_reported_as_unsettled_once() -> None:
    one = astray(lambda t: t % 1.0 < 0.4 and t > 15.0, 0.06)
    assert [event.kind for event in of(one.drive(60.0), "settled", "unsettled")] == ["settled", "unsettled"]


def test_lost_robot_unsettles_the_formation() -> None:
    one = Watcher()
    one.drive(15.0)
    (unsettled,) = of(one.drive(20.0, without="robot4"), "unsettled")
    known = "0 mm on 5 of 9 edges; 4 unknown (robot4 silent for 3 s)"
    assert unsettled.text == f"error not known over all edges; {known}; bound 50 mm"


def test_end_of_run_causes_no_unsettled_event() -> None:
    one = Watcher()
    one.drive(15.0)
    assert not of(one.run_until(30.0, []), "unsettled")


def test_rejections_are_reported_at_once_then_counted_periodically() -> None:
    one = Watcher()
    one.drive(12.0)
    bad = [command("robot2", 12.0 + i / 20, 0.1, 0.1)._replace(payload=b"rubbish") for i in range(500)]
    events = of(one.drive(43.0, *bad), "rejected")
    assert [event.at - EPOCH for event in events] == pytest.approx([12.1, 22.1, 32.1, 42.1], abs=0.2)
    assert {(event.robot, event.level) for event in events} == {("robot2", 30)}
    assert events[0].text.startswith("robot2/cmd_vel: geometry_msgs/msg/Twist: no CDR header")
    counts = [int(event.text.partition(" (")[2].split()[0]) for event in events if " (" in event.text]
    assert sum(counts) + len(events) - len(counts) == len(bad)  # every one is in some event


@pytest.mark.slow
def test_malformed_messages_do_not_flood_events() -> None:
    one = Watcher()
    rubbish = [
        command(robot, 12.0 + i / 50, 0.1, 0.1)._replace(
            key=f"{robot}/{topic}", payload=b"\0\1\0\0" + b"\xff" * kind
        )
        for i in range(500)
        for robot in one.fleet.mission.followers
        for topic, kind in (("odom", 3), ("cmd_vel", 5), ("position", 7), ("odom", 90), ("status", 8))
    ]
    events = of(one.drive(22.0, *rubbish), "rejected")
    assert MAX_REJECTION_KINDS <= len(events) <= 2 * MAX_REJECTION_KINDS + 1
    later = of(one.drive(22.0 + 4 * REJECTION_PERIOD), "rejected")
    kinds = {event.text.partition(" (")[0] for event in events + later}
    assert len(kinds) == len(one.monitor.metrics.rejections.by_reason)


def test_every_rejection_kind_is_reported_during_a_flood() -> None:
    one = Watcher()
    one.drive(12.0)
    quiet = one.monitor.metrics.snapshot(now(12.0))
    events, reported = Events(one.fleet.mission), set[str]()
    for look in range(400):
        flood = {f"robot2/odom: {kind}": 1 + look for kind in range(2 * MAX_REJECTION_KINDS + 4)}
        seen = events.collect_events(now(12.0 + look / 10), replace(quiet, rejected=flood))
        reported |= {event.text.partition(" (")[0] for event in seen if event.kind == "rejected"}
    assert reported == set(flood)


def test_events_of_unstable_radio_link_are_limited_and_counted() -> None:
    one = Watcher()
    one.drive(12.0)
    for _ in range(30):  # gone for 1.5 s and back for one
        one.drive(one.at + 1.5, without="robot3")
        one.drive(one.at + 1.0)
    flaps = of(one.reported, "lost", "back")
    assert 8 <= len(flaps) <= 6 + 75 / 10.0 + 1
    assert any("changes before were not reported" in event.text for event in flaps)
    one.drive(one.at + 15.0, without="robot3")
    assert [event for event in one.reported if event.robot == "robot3"][-1].kind == "lost"


def test_second_publisher_is_an_error_event_until_gone() -> None:
    one = Watcher()
    doubled = [status("robot4", 12.0 + i / 2, "run", "fine", contested=("robot2",)) for i in range(8)]
    (event,) = of(one.drive(15.0, *doubled), "contested")
    assert (event.robot, event.level) == ("robot2", 40)
    assert event.text == "its positions come from two processes"
    (after,) = of(one.drive(19.0, status("robot4", 16.0, "run", "fine")), "contested")
    assert (after.level, after.text) == (20, "its positions come from one process")


def test_noted_events_keep_order_and_are_published() -> None:
    one = Watcher()
    one.drive(12.0)
    noted = Event(12.0 + EPOCH, 20, "", "operator", "stop: all 6 robots")
    one.monitor.note(noted)
    assert of(one.drive(12.1), "operator") == [noted]
    numbered = [(number, event[1:]) for number, event in one.monitor.events]
    assert numbered == list(enumerate((event[1:] for event in one.reported), 1))


def test_event_survives_encoding_with_any_text() -> None:
    event = Event(1000.0, 30, "robot2", "rejected", "robot2/odom: \x1b[2J\udcff" + "long " * 1000)
    back = from_message(decode(LogEntry, encode(to_message(event))))
    assert back == event._replace(text=back.text)
    assert back.text.startswith("robot2/odom:  [2J long")
    assert len(back.text) == 500
    assert from_message(to_message(event._replace(robot=""))).robot == ""


@pytest.mark.parametrize("step", [-60.0, -0.5, 3600.0])
def test_set_clock_is_an_event_with_its_step(step: float) -> None:
    monitor = Monitor(Fleet().mission)
    assert not monitor.watch_clock(now(10.0))
    monitor.step(now(10.01)._replace(wall=10.01 + EPOCH + 0.05), [])  # too little to be reported
    later = now(10.02)._replace(wall=10.02 + EPOCH + 0.05 + step)
    (out,) = monitor.watch_clock(later)
    event = from_message(decode(LogEntry, out.payload))
    assert (event.kind, event.level) == ("clock", 30)
    assert event.at == pytest.approx(later.wall)
    assert clock_step(event) == pytest.approx(step, abs=1e-6)
    assert clock_step(event._replace(kind="operator")) == 0.0
    assert not of([numbered.event for numbered in monitor.events][1:], "clock")
    assert not [one for one in monitor.step(later, []) if one.payload == out.payload]


def test_monitor_keeps_newest_thousand_events() -> None:
    monitor = Monitor(Fleet().mission)
    for i in range(1200):
        monitor.note(Event(1010.0, 20, "", "operator", str(i)))
    monitor.step(now(10.1), [])
    assert [event.number for event in monitor.events] == list(range(201, 1201))


def test_page_chart_marks_all_event_kinds_of_states() -> None:
    script = Path(routes.__file__).with_name("site") / "script" / "chart.js"
    (symbols,) = (line for line in script.read_text().splitlines() if line.startswith("const SYMBOLS"))
    marked = set(re.findall(r"(\w+): ", symbols))
    assert {kind for kind, _ in STATES.values()} - {"waiting"} <= marked


@pytest.mark.parametrize("at", [-1.0, 2.0**31, 1e12])
def test_event_with_unrepresentable_time_is_still_published(at: float) -> None:
    monitor = Monitor(Fleet().mission)
    monitor.note(Event(at, 20, "", "operator", "stop: 6 of 6 obey"))
    published = [out for out in monitor.step(now(10.0), []) if out.key == EVENTS.key()]
    assert [decode(LogEntry, out.payload).text for out in published] == ["stop: 6 of 6 obey"]


SEES = {"sight": Sight.LOCKED, "sight_deviation": {"robot2": 0.006}, "sight_correction": 0.02}
LOST = {"sight": Sight.RECKONING, "sight_correction": 0.2}
STATUSES: list[tuple[str, str, list[dict[str, Any]], list[tuple[int, str]]]] = [
    ("robot1", "waits", [{"waits_for": names} for names in ((), ("robot4", "robot5"), ("robot5",), ())],
     [(30, "the leader waits for robot4, robot5"), (20, "the leader no longer waits")]),
    ("robot4", "fallback",
     [{"follows": names} for names in (("robot2", "robot3"), ("robot1",), ("robot2",))],
     [(30, "none of its own neighbours is left, it follows robot1"), (20, "its own neighbours are back")]),
    ("robot4", "stuck", [{"motion": MotionFault.FROZEN}, {}],
     [(30, "does not move as commanded"), (20, "moves again")]),
    ("robot4", "deadlock", [{"deadlocks": count} for count in (0, 1, 1, 2, 0)],
     [(20, f"resolves a deadlock by another way ({count} so far)") for count in (1, 2)]),
    ("robot2", "runs", [{"reason": "fine", "readonly": True}], [(20, "read only: fine")]),
    ("robot4", "sight drift", [SEES, SEES, LOST, LOST, SEES],
     [(20, "sees its neighbours: robot2 to 6 mm"), (30, "sees no neighbour, goes on by odometry"),
      (30, "odometry alone would be off by 0.20 m; scans correct it"),
      (20, "sees its neighbours: robot2 to 6 mm")]),
]  # fmt: skip


@pytest.mark.parametrize(("robot", "kinds", "states", "reported"), STATUSES, ids=[one[1] for one in STATUSES])
def test_status_changes_are_events(
    robot: str, kinds: str, states: list[dict[str, Any]], reported: list[tuple[int, str]]
) -> None:
    samples = [status(robot, 11.0 + n / 2, "run", **values) for n, values in enumerate(states)]
    events = of(Watcher().drive(15.0, *samples), *kinds.split())
    assert [(event.level, event.text) for event in events] == reported
    assert {event.robot for event in events} == {"" if robot == "robot1" else robot}


CLEAR: dict[str, Any] = {"collisions": CollisionMode.ON, "zone": Zone.CLEAR}
AVOIDS = {**CLEAR, "avoiding": True}


@pytest.mark.parametrize(
    ("state", "words", "does"),
    [
        ("run", CLEAR, ""),
        ("run", AVOIDS, "avoids"),
        ("run", {**AVOIDS, "zone": Zone.SLOW}, "slowed"),
        ("run", {**AVOIDS, "zone": Zone.STOP}, "blocked"),
        ("run", {"zone": Zone.STOP}, "blocked"),
        ("hold", {"zone": Zone.STOP}, ""),
        ("run", {"collisions": CollisionMode.WARN, "avoiding": True}, ""),
        ("run", {}, ""),
    ],
)
def test_avoiding_state_follows_from_status(state: str, words: dict[str, Any], does: str) -> None:
    metrics = received(Fleet(), status("robot4", 11.5, state, deadlocks=2, **words))
    snapshot = metrics.snapshot(now(12.0))
    assert snapshot.robots["robot4"].avoiding == does
    statuses = [one for message in diagnostics(snapshot, 12.0) for one in message.statuses]
    (reported,) = (one.values for one in statuses if one.name == "robot4: monitor")
    assert (reported.get("avoiding", ""), reported["deadlocks"]) == (does, "2")


@pytest.mark.parametrize(
    ("text", "count"), [("3", 3), ("0", 0), ("-1", 0), ("many", 0), ("9" * 400, 0), ("x³", 0)]
)
def test_invalid_deadlock_count_is_read_as_zero(text: str, count: int) -> None:
    what = {"kind": "agent", "robot": "robot4", "state": "run", "reason": "running", "deadlocks": text}
    message = Diagnostics(11.5 + EPOCH, (Status("", 0, "", "", what),))
    snapshot = received(Fleet(), sample_of(STATUS.key("robot4"), message, 11.5)).snapshot(now(12.0))
    assert snapshot.robots["robot4"].deadlocks == count
    assert as_json(snapshot)["robots"]["robot4"]["deadlocks"] == count


def test_events_report_avoiding_blocked_and_finally_clear() -> None:
    words = [CLEAR, AVOIDS, CLEAR, AVOIDS, {"zone": Zone.STOP}, *[CLEAR] * 7]
    samples = [status("robot4", 11.0 + n / 2, "run", **each) for n, each in enumerate(words)]
    reported = Watcher().drive(14.0 + CLEAR_TIME, *samples)
    assert [(event.kind, event.level, event.text) for event in reported if event.robot == "robot4"][-3:] == [
        ("avoiding", 20, "avoids a collision"),
        ("blocked", 30, "stopped by its protective zone"),
        ("clear", 20, "no obstacle limits its command any more"),
    ]
    assert len(of(reported, "avoiding")) == 1


def test_summary_line_gives_odometry_drift() -> None:
    seeing = status("robot4", 11.5, "run", sight=Sight.LOCKED, sight_correction=0.12)
    snapshot = received(Fleet(), seeing).snapshot(now(12.0))
    assert "(odometry alone would be off by up to 120.0 mm: robot4)" in line(snapshot)
    assert as_json(snapshot)["robots"]["robot4"]["sight"] == "locked"


def test_report_contains_durations_of_avoiding_and_blocking(tmp_path: Path) -> None:
    words = {10.0: AVOIDS, 11.0: {"zone": Zone.STOP, "deadlocks": 1}, 12.5: {**CLEAR, "deadlocks": 1}}
    samples = [one for one in talk(Fleet(), 4.0) if one.key != STATUS.key("robot4")]
    held = {at: max(since for since in words if since <= at) for at in (10.0 + n / 2 for n in range(8))}
    samples += [status("robot4", at, "run", **words[since]) for at, since in held.items()]
    run = run_of(tmp_path, sorted(samples, key=lambda one: one.arrived))
    did = run.activities["robot4"]
    assert (did.avoiding, did.blocked) == pytest.approx((1.0, 1.5), abs=0.4)
    assert did.deadlocks == 1
    table = tables.activities(run)
    (row,) = (row for row in table.rows if row[0] == "robot4")
    assert row[table.heads.index("deadlocks")] == "1"
    assert {"avoiding", "blocked"} <= set(table.heads)


def test_each_changed_part_of_the_order_is_an_event() -> None:
    changes: list[dict[str, Any]] = [
        {"shape": "wedge"}, {"rotation": math.pi / 4}, {"scale": 1.5}, {"route": "c4f2a1b2c3d4"},
        {"mode": "hold"}, {"mode": "stop"},
    ]  # fmt: skip

    def wants(time: float) -> ChainMap[str, Any]:
        return ChainMap(*reversed(changes[: max(0, int(time / 2.0) - 5)]))  # from 12 s on, two seconds apart

    events = of(Watcher(Fleet(wants=wants)).drive(24.0), "order")
    turned = "shape wedge, turned by 45°"
    large = f"{turned}, 1.5 times as large"
    assert [event.text.removeprefix("the leader orders ") for event in events] == [
        "run, shape hexagon", "run, shape wedge", f"run, {turned}", f"run, {large}",
        *(f"{mode}, {large}, on ordered route c4f2a1b2" for mode in ("run", "hold", "stop")),
    ]  # fmt: skip
    assert [event.level for event in events] == [20] * 5 + [30, 30]
    assert {event.robot for event in events} == {""}


def test_end_of_shape_transition_is_reported_as_formed() -> None:
    def wants(time: float) -> dict[str, Any]:
        part = min(max((time - 15.0) / 3.0, 0.0), 1.0)
        if not 0.0 < part < 1.0:
            return {"shape": "wedge"} if part else {}
        return {"shape": "wedge", "slots": Slots(mix={"hexagon": 1.0 - part, "wedge": part})}

    events = Watcher(Fleet(wants=wants)).drive(25.0)
    (formed,) = of(events, "formed")
    assert formed.text.startswith("the slots are where they are wanted, 3.")
    first, unsettled, again = of(events, "settled", "unsettled")
    assert (first.kind, again.kind) == ("settled", "settled")
    assert unsettled[1:] == (20, "", "unsettled", "another shape is on its way")
    assert re.search(r"since 8\.\d s, 3\.[01] s after what was ordered last$", again.text)


def with_attachment(at: float, **values: Any) -> Sample:
    """A position of robot3 with these values in its attachment."""
    attachment = PositionAttachment.model_validate({"publisher_id": "a", "count": 1, **values})
    return Fleet().position("robot3", at)._replace(attachment=json_message.encode(attachment))


def test_unavailable_at_the_start_is_no_warning() -> None:
    (event,) = of(Watcher().run_until(10.1, [with_attachment(10.001, unavailable=True)]), "unavailable")
    assert (event.robot, event.level) == ("robot3", 20)


def test_unavailable_and_following_again_are_events() -> None:
    one = Watcher()
    one.drive(11.0)
    (unavailable,) = of(one.drive(12.0, with_attachment(11.501, unavailable=True)), "unavailable")
    assert (unavailable.robot, unavailable.level) == ("robot3", 30)
    assert one.seen.robots["robot3"].unavailable
    (follows,) = of(one.drive(13.0, with_attachment(12.501, count=2)), "follows")
    assert (follows.robot, follows.level) == ("robot3", 20)


def test_robot_that_never_appears_is_reported_once() -> None:
    (absent,) = of(Watcher().drive(40.0, without="robot3"), "absent")
    assert (absent.robot, absent.level) == ("robot3", 30)
    assert absent.at - EPOCH == pytest.approx(10.0 + START_TIME, abs=0.2)


def test_frozen_monitor_calls_no_robot_silent() -> None:
    one = Watcher()
    one.drive(15.0)
    one.at = 75.0
    one.run_until(75.1, [])
    one.drive(80.0)
    frozen, *others = one.reported[len(one.reported) - 1 :]
    assert (frozen.kind, frozen.text) == (
        "frozen", "the monitor was frozen for 60.0 s, limit 1 s; messages of that time may be missing"
    )  # fmt: skip
    assert not others
    assert not of(one.reported, "lost")


def published_by(publisher: str, samples: list[Sample]) -> list[Sample]:
    """The positions of robot6 among these as of another process."""
    return [
        one._replace(attachment=json_message.encode(PositionAttachment(publisher_id=publisher, count=number)))
        for number, one in enumerate(samples)
        if one.key == POSITION.key("robot6")
    ]


def test_second_publisher_beside_first_is_contested() -> None:
    one = Watcher()
    positions = one.fleet.positions(10.0, 20.0)
    first, second = published_by("a", positions), published_by("b", one.fleet.positions(15.025, 20.0))
    events = one.run_until(20.0, [*(it for it in positions if "robot6" not in it.key), *first, *second])
    (contested,) = of(events, "contested")
    assert (contested.robot, contested.level) == ("robot6", 40)
    assert contested.at - EPOCH == pytest.approx(15.2, abs=0.2)
    assert one.seen.missed == 0


def test_publisher_after_another_is_not_contested() -> None:
    one = Watcher()
    positions = one.fleet.positions(10.0, 20.0)
    half = len(positions) // 2
    first, second = published_by("a", positions[:half]), published_by("b", positions[half:])
    events = one.run_until(20.0, [*(it for it in positions if "robot6" not in it.key), *first, *second])
    assert not of(events, "contested")
    assert len(of(events, "restarted")) == 1


def test_restarted_process_is_reported_once() -> None:
    samples = [with_attachment(11.001 + n / 2, publisher_id=one, count=n) for n, one in enumerate("aabab")]
    (restarted,) = of(Watcher().drive(15.0, *samples), "restarted")
    assert (restarted.robot, restarted.level) == ("robot3", 30)


def status_with_requests(robot: str, at: float, requested: str) -> Sample:
    """A leader's status with this under `requests`."""
    values = {"kind": "leader", "robot": robot, "state": "run", "requests": requested}
    return sample_of(STATUS.key(robot), Diagnostics(at + EPOCH, (Status("", 0, "", "", values),)), at)


def test_operator_request_is_reported_once_with_its_reply() -> None:
    requested = [
        {"do": "shape", "shape": "wedge", "id": "a1", "ok": True, "reason": "in 4.2 s"},
        {"do": "speed", "speed": 9.0, "degrees": 45.0, "id": "b2", "ok": False, "reason": "at most 1.5 m/s"},
    ]
    stop = {"do": "stop", "id": "a1", "ok": True, "reason": ""}  # ids count per kind of request
    samples = [
        status_with_requests("robot1", 11.0 + n / 2, json.dumps(requested if n < 3 else [*requested, stop]))
        for n in range(6)
    ]
    other = status_with_requests("spare1", 14.2, json.dumps([stop]))
    events = of(Watcher(Fleet(with_standbys())).drive(16.0, *samples, other), "requested")
    assert [(event.robot, event.level, event.text) for event in events] == [
        ("robot1", 20, "shape wedge; it obeys: in 4.2 s"),
        ("robot1", 30, "speed 9 45; it refuses: at most 1.5 m/s"),
        ("robot1", 20, "stop; it obeys"),
        ("spare1", 20, "stop; it obeys"),
    ]


@pytest.mark.parametrize(
    "requested",
    ["", "5", "[[]]", "[" * 5000, '[{"do": "dance", "id": "x"}]', '[{"do": "stop"}]', '{"do": "stop"}'],
)
def test_malformed_requests_cause_no_event(requested: str) -> None:
    assert not of(Watcher().drive(13.0, status_with_requests("robot1", 11.0, requested)), "requested")
