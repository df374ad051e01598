"""Orders of the command line are in the recording: content, id, time and answer."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest

from formation.monitor.metrics.event import from_message
from formation.monitor.recording.reader import read
from formation.ros2.messages import Diagnostics, LogEntry, decode
from formation.topics import EVENTS, STATUS
from tests.processes.fleet.twenty import LEADER, twenty
from tests.support.child import started

pytestmark = pytest.mark.processes
SECOND_SHAPE = "[shapes.apart]\nrobot1 = [-1.5, -2.0]\nrobot2 = [-1.0, 0.5]\n"
ROUTE = "[[route]]\nspeed = 0.05\nheading_deg = 10\n"
REFUSED = "run "
"""Refused by robots that are stopped."""
WORDS = (
    "stop", REFUSED, "release", "hold", "run",
    "shape apart", "rotate -30", "scale 1.5", "speed 0.05 90", "route way.toml",
)  # fmt: skip
SLACK = 2.0
"""Longest time until a status is recorded, also on a busy machine [s]."""


def answer_time(order: dict[str, Any]) -> float:
    """Return when the leader's answer to an order came [s]; to link may have taken some time."""
    (one,) = [one for one in (*order["acknowledged"], *order["refused"]) if one["robot"] == LEADER]
    return float(order["at"] + 1e-3 * one["ms"])


def test_all_nine_orders_are_recorded_with_their_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "way.toml").write_text(ROUTE)
    record = tmp_path / "run.mcap"
    with (
        twenty(tmp_path, 2, SECOND_SHAPE) as team,
        started("formation.monitor", str(team.file), "--record", str(record), "--no-page") as monitor,
    ):
        monitor.event("ready")
        given = [team.order(*words.split()) for words in WORDS]
        monitor.signal(signal.SIGINT)
    assert [one.code for one in given] == [int(words == REFUSED) for words in WORDS], given
    orders = [one.report for one in given]

    result: dict[str, tuple[float, dict[str, Any]]] = {}
    events = []
    for message in read(record).messages():
        if message.sample.key == STATUS.key(LEADER):
            for status in decode(Diagnostics, message.sample.payload).statuses:
                for one in json.loads(status.values.get("requests", "[]")):
                    result.setdefault(one["id"], (message.wall, one))
        elif message.sample.key == EVENTS.key():
            events.append(from_message(decode(LogEntry, message.sample.payload)))
    assert list(result) == [one["id"] for one in orders]
    for order, (when, one) in zip(orders, result.values(), strict=True):
        reported = {key: value for key, value in one.items() if key not in {"age", "ok", "reason"}}
        assert order == {**order, **reported}
        assert one["ok"] == (not order["refused"])
        assert order["at"] <= when <= answer_time(order) + SLACK
    requested = [event.text for event in events if event.kind == "requested"]
    assert len(requested) == len(orders)
