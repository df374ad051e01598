from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from formation.mission.file import parse, read
from formation.monitor.core import Monitor
from formation.monitor.metrics.events import (
    LOST_SILENCE,
    MAX_REJECTION_KINDS,
    REJECTION_PERIOD,
    START_TIME,
    STATES,
    Event,
    Events,
    from_message,
    to_message,
)
from formation.monitor.web import routes
from formation.ros2.messages import LogEntry, decode, encode
from formation.topics import EVENTS
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, command, now, status


class Watcher:
    """A monitor that is shown what a test has happen, fifty times a second."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.monitor = Monitor(fleet.mission)
        self.reported: list[Event] = []
        self.at = 10.0

    def run_until(self, until: float, samples: list[Sample]) -> list[Event]:
        """Pass the time until `until`; what is told meanwhile."""
        samples = sorted(samples, key=lambda sample: sample.arrived)
        before = len(self.reported)
        while self.at < until - 1e-9:
            self.at += 0.02
            due = [sample for sample in samples if sample.arrived <= self.at]
            samples = samples[len(due) :]
            for out in self.monitor.step(now(self.at), due):
                if out.key == EVENTS.key():
                    self.reported.append(from_message(decode(LogEntry, out.payload)))
        return self.reported[before:]

    def drive(self, until: float, *more: Sample, without: str = "") -> list[Event]:
        """As `run_until`, with everybody's positions but those of the robot `without`."""
        return self.run_until(until, [*self.fleet.positions(self.at, until, without=without), *more])


def of(events: list[Event], kind: str) -> list[Event]:
    return [event for event in events if event.kind == kind]


def watcher(away: Callable[[str, float], complex] | None = None) -> Watcher:
    return Watcher(Fleet() if away is None else Fleet(away=away))


def test_each_robot_joins_once() -> None:
    one = watcher()
    joined = of(one.drive(20.0), "joined")
    assert [event.robot for event in joined] == list(one.fleet.mission.names)
    assert {event.level for event in joined} == {20}
    assert joined[0].at == pytest.approx(10.1 + EPOCH, abs=0.1)


def test_silent_robot_is_lost_within_1_2_seconds() -> None:
    one = watcher()
    one.drive(15.0, status("robot3", 14.9, "run", "in formation control"))
    (lost,) = of(one.drive(18.0, without="robot3"), "lost")
    last = max(time for time in one.fleet.times("robot3", 10.0, 15.0))
    assert LOST_SILENCE < lost.at - EPOCH - last <= 1.2
    assert (lost.robot, lost.level) == ("robot3", 40)
    assert lost.text.startswith("silent for 1.")
    assert "last state: run" in lost.text


def test_loss_after_announced_stop_is_only_a_warning() -> None:
    one = watcher()
    one.drive(15.0, status("robot3", 14.9, "stop", "SIGTERM"))
    (lost,) = of(one.drive(18.0, without="robot3"), "lost")
    assert lost.level == 30
    assert lost.text.endswith("last state: stop")


def test_returned_robot_reports_duration_of_silence() -> None:
    one = watcher()
    one.drive(15.0)
    one.drive(20.0, without="robot3")
    (back,) = of(one.drive(21.0), "back")
    assert (back.robot, back.level) == ("robot3", 20)
    assert back.text == "after 5.1 s of silence"
    assert not of(one.reported, "joined")[len(one.fleet.mission.names) :]


def test_silent_robot_without_history_is_not_lost() -> None:
    events = watcher().drive(20.0, without="robot5")
    assert not of(events, "lost")
    assert "robot5" not in {event.robot for event in of(events, "joined")}


def test_a_robot_that_speaks_seldom_is_not_lost_between_two_words() -> None:
    text, name = read("six_robots")
    one = Watcher(Fleet(parse(text.replace("rate = 20", "rate = 1", 1), name)))
    assert not of(one.drive(30.0), "lost")
    last = max(time for time in one.fleet.times("robot3", 10.0, 30.0))
    (lost,) = of(one.drive(40.0, without="robot3"), "lost")
    assert 3.0 < lost.at - EPOCH - last <= 4.2


def test_what_robots_say_of_themselves_is_told_when_it_changes() -> None:
    one = watcher()
    said_by_robot2 = [
        ("waiting", "no order from the leader yet"),
        ("run", "in formation control"),
        ("run", "in formation control"),
        ("hold", "odometry silent for 0.20 s"),
        ("hold", "odometry silent for 0.70 s"),
        ("stop", "stopped by the operator"),
        ("run", "in formation control"),
    ]
    samples = [status("robot2", 10.5 + i / 2, *words) for i, words in enumerate(said_by_robot2)]
    events = [event for event in one.drive(15.0, *samples) if event.robot == "robot2"]
    assert [(event.kind, event.level, event.text) for event in events if event.kind != "joined"] == [
        ("waiting", 20, "no order from the leader yet"),
        ("runs", 20, "in formation control"),
        ("held", 30, "odometry silent for 0.20 s"),
        ("stopped", 30, "stopped by the operator"),
        ("runs", 20, "in formation control"),
    ]


def test_a_healthy_start_has_no_warning() -> None:
    one = watcher()
    said_by_robot2 = [
        ("hold", "no link to the robot"),
        ("waiting", "no odometry yet"),
        ("hold", "no two odometry messages within 0.15 s"),
        ("waiting", "no order from the leader yet"),
        ("run", "in formation control"),
    ]
    samples = [status("robot2", 10.5 + i / 2, *words) for i, words in enumerate(said_by_robot2)]
    events = one.drive(15.0, *samples)
    assert {event.level for event in events} == {20}
    assert [event.kind for event in events if event.robot == "robot2"] == ["joined", "waiting", "runs"]


def test_a_robot_that_cannot_start_is_a_warning() -> None:
    one = watcher()
    samples = [status("robot2", 10.5 + i / 2, "hold", "no link to the robot") for i in range(20)]
    (held,) = of(one.drive(20.0, *samples), "held")
    assert (held.robot, held.level, held.text) == ("robot2", 30, "no link to the robot")
    assert held.at - EPOCH - 10.5 == pytest.approx(START_TIME, abs=0.3)


def test_a_robot_that_only_watches_says_so() -> None:
    (event,) = of(watcher().drive(12.0, status("robot2", 10.5, "run", "fine", readonly=True)), "runs")
    assert event.text == "read only: fine"


def test_silent_status_creates_no_event() -> None:
    one = watcher()
    one.drive(12.0, status("robot2", 10.5, "run", "fine"))
    assert not [event for event in one.drive(20.0) if event.robot == "robot2"]
    assert not [event for event in one.drive(21.0, status("robot2", 20.2, "run", "fine")) if event.robot]


def test_changed_leader_orders_become_events() -> None:
    one = watcher()
    (first,) = of(one.drive(12.0), "order")
    assert (first.robot, first.level, first.text) == ("", 20, "the leader orders run, shape hexagon")
    one.fleet.mode = "stop"
    (second,) = of(one.drive(14.0), "order")
    assert (second.level, second.text) == (30, "the leader orders stop, shape hexagon")


def test_settled_event_survives_brief_error_at_bound() -> None:
    one = watcher(lambda robot, t: 0.06j if robot == "robot6" and t % 3.0 < 0.15 and t > 15.0 else 0j)
    (settled,) = of(one.drive(30.0), "settled")
    assert settled.at - EPOCH == pytest.approx(12.1, abs=0.2)
    assert (settled.robot, settled.level, settled.text) == (
        "",
        20,
        "under the bound of 50 mm since 0.0 s",
    )
    assert not of(one.reported, "unsettled")


def test_settled_event_without_known_time_omits_it() -> None:
    one = watcher()
    one.drive(12.0)
    seen = one.monitor.snapshot
    assert seen is not None
    touching = replace(seen, converged=True, settled_at=None)
    events = Events(one.fleet.mission)
    reported = [
        event for step in range(200) for event in events.collect_events(now(20.0 + 0.02 * step), touching)
    ]
    assert [event.text for event in reported if event.kind == "settled"] == ["under the bound of 50 mm"]


def test_a_formation_that_is_driven_apart_is_unsettled_and_settles_again() -> None:
    one = watcher(lambda robot, t: 0.3 if robot == "robot6" and 15.0 < t < 20.0 else 0)
    events = [event for event in one.drive(25.0) if event.kind in {"settled", "unsettled"}]
    assert [event.kind for event in events] == ["settled", "unsettled", "settled"]
    unsettled = events[1]
    assert unsettled.at - EPOCH == pytest.approx(16.1, abs=0.2)
    assert unsettled.text == "error 600 mm, the bound of 50 mm"
    assert unsettled.level == 30


def test_oscillating_error_is_reported_as_unsettled_once() -> None:
    one = watcher(lambda robot, t: 0.06j if robot == "robot6" and t % 1.0 < 0.4 and t > 15.0 else 0j)
    events = [event.kind for event in one.drive(60.0) if event.kind in {"settled", "unsettled"}]
    assert events == ["settled", "unsettled"]


def test_a_formation_of_which_a_robot_is_lost_has_not_settled() -> None:
    one = watcher()
    one.drive(15.0)
    (unsettled,) = of(one.drive(20.0, without="robot4"), "unsettled")
    over = "5 of 9 edges; 4 unknown (robot4 silent for 3 s)"
    assert unsettled.text == f"error 0 mm over {over}, the bound of 50 mm"


def test_the_end_of_a_run_unsettles_nothing() -> None:
    one = watcher()
    one.drive(15.0)
    assert not of(one.run_until(30.0, []), "unsettled")


def test_rejected_messages_are_told_at_once_and_then_by_the_count() -> None:
    one = watcher()
    one.drive(12.0)
    bad = [command("robot2", 12.0 + i / 20, 0.1, 0.1)._replace(payload=b"rubbish") for i in range(500)]
    events = of(one.drive(43.0, *bad), "rejected")
    assert [event.at - EPOCH for event in events] == pytest.approx([12.1, 22.1, 32.1, 42.1], abs=0.2)
    assert {(event.robot, event.level) for event in events} == {("robot2", 30)}
    assert events[0].text.startswith("robot2/cmd_vel: geometry_msgs/msg/Twist: no CDR header")
    counts = [int(event.text.partition(" (")[2].split()[0]) for event in events if " (" in event.text]
    assert sum(counts) + len(events) - len(counts) == len(bad)  # every one is in some event


def test_malformed_messages_do_not_flood_events() -> None:
    one = watcher()
    rubbish = [
        command("robot2", 12.0 + i / 50, 0.1, 0.1)._replace(
            key=f"{robot}/{topic}", payload=bytes([0, 1, 0, 0]) + b"\xff" * kind
        )
        for i in range(500)
        for robot in one.fleet.mission.followers
        for topic, kind in (("odom", 3), ("cmd_vel", 5), ("position", 7), ("odom", 90), ("status", 8))
    ]
    events = of(one.drive(22.0, *rubbish), "rejected")
    assert MAX_REJECTION_KINDS <= len(events) <= 2 * MAX_REJECTION_KINDS + 1
    later = of(one.drive(22.0 + 4 * REJECTION_PERIOD), "rejected")
    assert len({event.text.partition(" (")[0] for event in events + later}) == len(
        one.monitor.metrics.rejections.by_reason
    )


def test_of_many_kinds_that_flood_all_have_their_turn() -> None:
    one = watcher()
    one.drive(12.0)
    quiet = one.monitor.metrics.snapshot(now(12.0))
    events, reported = Events(one.fleet.mission), set[str]()
    for look in range(400):
        flood = {f"robot2/odom: {kind}": 1 + look for kind in range(2 * MAX_REJECTION_KINDS + 4)}
        seen = events.collect_events(now(12.0 + look / 10), replace(quiet, rejected=flood))
        reported |= {event.text.partition(" (")[0] for event in seen if event.kind == "rejected"}
    assert reported == set(flood)


def test_unstable_radio_link_limits_events_and_counts_changes() -> None:
    one = watcher()
    one.drive(12.0)
    for _ in range(30):  # gone for 1.5 s and back for one
        one.drive(one.at + 1.5, without="robot3")
        one.drive(one.at + 1.0)
    flaps = [event for event in one.reported if event.robot == "robot3" and event.kind in {"lost", "back"}]
    assert 8 <= len(flaps) <= 6 + 75 / 10.0 + 1
    assert any("changes before were not reported" in event.text for event in flaps)
    one.drive(one.at + 15.0, without="robot3")
    assert [event for event in one.reported if event.robot == "robot3"][-1].kind == "lost"


def second_publisher(robot: str, of_robot: str, at: float) -> Sample:
    return status(robot, at, "run", "fine", contested=(of_robot,))


def test_second_publisher_is_an_error_event_until_gone() -> None:
    one = watcher()
    doubled = [second_publisher("robot4", "robot2", 12.0 + i / 2) for i in range(8)]
    (event,) = of(one.drive(15.0, *doubled), "contested")
    assert (event.robot, event.level) == ("robot2", 40)
    assert event.text == "its neighbours receive messages of a second publisher"
    (after,) = of(one.drive(19.0, status("robot4", 16.0, "run", "fine")), "contested")
    assert (after.level, after.text) == (20, "its neighbours receive messages of one publisher")


def test_noted_events_keep_order_and_are_published() -> None:
    one = watcher()
    one.drive(12.0)
    noted = Event(12.0 + EPOCH, 20, "", "operator", "stop: all 6 robots")
    one.monitor.note(noted)
    assert of(one.drive(12.1), "operator") == [noted]
    assert [number for number, _ in one.monitor.events] == list(range(1, len(one.reported) + 1))
    assert [event[1:] for _, event in one.monitor.events] == [event[1:] for event in one.reported]


def test_event_survives_encoding_with_any_text() -> None:
    event = Event(1000.0, 30, "robot2", "rejected", "robot2/odom: \x1b[2J\udcff" + "long " * 1000)
    back = from_message(decode(LogEntry, encode(to_message(event))))
    assert back == event._replace(text=back.text)
    assert back.text.startswith("robot2/odom:  [2J long")
    assert len(back.text) == 500
    assert from_message(to_message(event._replace(robot=""))).robot == ""


def test_the_newest_thousand_are_kept() -> None:
    one = watcher()
    for i in range(1200):
        one.monitor.note(Event(1010.0, 20, "", "operator", str(i)))
    one.drive(10.1)
    assert len(one.monitor.events) == 1000
    assert one.monitor.events[-1].number >= 1200


def test_monitor_offers_its_newest_snapshot() -> None:
    one = watcher()
    one.drive(10.02)
    first = one.monitor.snapshot
    one.drive(12.0)
    assert first is not one.monitor.snapshot
    assert one.monitor.snapshot is not None
    assert one.monitor.snapshot.mode == "run"


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
