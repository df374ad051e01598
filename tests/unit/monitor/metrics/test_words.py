"""Metrics in words: JSON, a line, diagnostics; no metric, event kind or level depends on a sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from formation.control.zones import Zone
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import as_json, diagnostics, line
from formation.protocol import reasons, status_codec
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import CollisionMode, MotionFault, RobotLink
from formation.ros2.messages import MAX_PAYLOAD_BYTES, encode
from formation.wire import Sample
from tests.support.monitored import (
    Fleet,
    Watcher,
    command,
    now,
    odometry,
    receive,
    received,
    status,
    with_standbys,
)


def snapshot(*, without: str = "") -> Snapshot:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 12.0, without=without))
    receive(metrics, [status(name, 11.5, "run", "fine") for name in fleet.mission.names])
    return metrics.snapshot(now(12.0))


def test_snapshot_without_messages_is_valid_json() -> None:
    known = json.loads(json.dumps(as_json(Metrics(Fleet().mission).snapshot(now(10.0))), allow_nan=False))
    assert (known["formation_error"], known["elapsed"], known["robots"]["robot2"]["age"]) == (None, 0.0, None)
    assert ["robot2", "robot1", None] in known["edges"]


def test_summary_line_names_unknown_error_and_silent_robots() -> None:
    assert "error 0.0 mm" in line(snapshot())
    assert "6 run" in line(snapshot())
    metrics = received(
        Fleet(), *Fleet().positions(10.0, 12.0), *Fleet().positions(12.05, 15.0, without="robot3")
    )
    text = line(metrics.snapshot(now(25.0)))
    assert "error unknown" in text
    assert "robot3 silent for 13.0 s" in text


def test_diagnostics_contain_robots_edges_and_key_rates() -> None:
    samples = [*Fleet().positions(10.0, 12.0), odometry("robot4", 12.0), command("robot4", 12.0, 0.3, 0.1)]
    (message,) = diagnostics(received(Fleet(), *samples).snapshot(now(12.0)), 1012.0)
    formation, *robots = message.statuses
    assert formation.values["error"] == "0.0000"
    assert [robot.hardware_id for robot in robots] == list(Fleet().mission.names)
    assert robots[3].values.items() >= {
        "error.robot2": "0.0000", "error.robot3": "0.0000", "speed": "0.3000", "count.odom": "1",
        "rate.position": "20.0",
    }.items()  # fmt: skip


def test_diagnostics_of_silent_robot_are_stale() -> None:
    (message,) = diagnostics(snapshot(without="robot5"), 1012.0)
    levels = {status.name.removesuffix(": monitor"): status.level for status in message.statuses}
    # the errors of the other edges are known
    assert (levels["robot5"], levels["robot4"], levels["formation"]) == (3, 0, 1)


def test_diagnostics_of_100_robots_fit_into_messages() -> None:
    few = snapshot()
    many = replace(few, robots={f"robot{i}": few.robots["robot4"] for i in range(100)})
    messages = list(diagnostics(many, 1012.0))
    assert sum(len(message.statuses) for message in messages) == 101
    assert max(len(encode(message)) for message in messages) < MAX_PAYLOAD_BYTES


NONSENSE = "zzz"


def sent() -> list[Sample]:
    """Statuses with every field that the monitor reads."""
    silent = Reason.of(Code.POSITION_SILENT, source="odometry", age=0.3, limit=0.15)
    waits = Reason.of(Code.WAITS, robots=("robot4",))
    blocked: dict[str, Any] = {"collisions": CollisionMode.ON, "zone": Zone.STOP, "deadlocks": 2}
    return [
        status("spare1", 11.0, "run", waits, leads=True, waits_for=("robot4",)),
        status("robot1", 11.0, "standby", Reason.of(Code.OTHER_LEADS, robot="spare1")),
        status("robot2", 11.0, "run", contested=("robot5",), forged={"robot6": "not signed"}),
        status("robot3", 11.0, "run", link=RobotLink.NO_LISTENER, avoiding=True, **blocked),
        status("robot4", 10.5, "run"),
        status("robot4", 11.0, "hold", silent, motion=MotionFault.FROZEN, follows=("robot6",)),
        status("robot5", 11.0, "run", readonly=True),
    ]


def seen() -> tuple[dict[str, Any], list[tuple[str, str, int]]]:
    """All metrics but the reasons, and each event's robot, kind and level."""
    one = Watcher(Fleet(with_standbys(), term=64 * 10 + 1))
    events = one.drive(12.0, *sent())
    metrics = as_json(one.seen)
    for reported in (*metrics["robots"].values(), *metrics["candidates"].values()):
        del reported["reason"]
    return metrics, [(event.robot, event.kind, event.level) for event in events]


def test_reason_texts_do_not_affect_metrics_or_events(monkeypatch: pytest.MonkeyPatch) -> None:
    before = seen()
    monkeypatch.setattr(reasons, "SENTENCES", dict.fromkeys(reasons.SENTENCES, NONSENSE))
    for name in ("LINKS", "MOTION_FAULTS"):
        monkeypatch.setattr(status_codec, name, dict.fromkeys(getattr(status_codec, name), NONSENSE))
    assert str(Reason(Code.RUNNING)) == NONSENSE
    assert seen() == before
    metrics, events = before
    assert metrics["robots"]["robot4"]["reason_code"] == Code.POSITION_SILENT
    assert metrics["waits"] == "robot4"
    assert {("robot5", "contested", 40), ("robot6", "forged", 40)} <= set(events)
    assert {kind for _, kind, _ in events} >= {"blocked", "stuck", "fallback", "waits", "held", "deadlock"}
