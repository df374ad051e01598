"""No figure, event kind or level depends on what a sentence says."""

from __future__ import annotations

from typing import Any

import pytest

from formation.control.zones import Zone
from formation.monitor.metrics.words import as_json
from formation.protocol import reasons, status_codec
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import CollisionMode, MotionFault, RobotLink
from formation.wire import Sample
from tests.support.monitored import Fleet, now, status, with_standbys
from tests.unit.monitor.metrics.test_events import Watcher

NONSENSE = "zzz"


def sent() -> list[Sample]:
    """Statuses in which robots say all that the monitor reads."""
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
    metrics = as_json(one.monitor.metrics.snapshot(now(12.0)))
    for reported in (*metrics["robots"].values(), *metrics["candidates"].values()):
        del reported["reason"]
    return metrics, [(event.robot, event.kind, event.level) for event in events]


def test_nonsense_sentences_change_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    before = seen()
    monkeypatch.setattr(reasons, "SENTENCES", dict.fromkeys(reasons.SENTENCES, NONSENSE))
    for name in ("LINKS", "MOTION_FAULTS"):
        monkeypatch.setattr(status_codec, name, dict.fromkeys(getattr(status_codec, name), NONSENSE))
    assert str(Reason(Code.RUNNING)) == NONSENSE
    assert seen() == before
    metrics, events = before
    assert metrics["robots"]["robot4"]["reason_code"] == Code.POSITION_SILENT
    assert metrics["waits"] == "robot4"
    assert ("robot5", "contested", 40) in events
    assert ("robot6", "forged", 40) in events
    assert {kind for _, kind, _ in events} >= {"blocked", "stuck", "fallback", "waits", "held", "deadlock"}
