"""A monitor process with a full disk continues to watch, and reports it.

That recording resumes is tested faster than in real time (`test_disk.py`).
"""

from __future__ import annotations

import json
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from formation.monitor.recording.reader import read
from formation.ros2.messages import LogEntry, decode
from formation.topics import EVENTS, ODOM
from tests.processes.agent.actor import Actor, watching
from tests.support.child import PATIENCE, Child, until
from tests.support.disks import in_memory
from tests.support.recordings import has_end

pytestmark = [pytest.mark.processes, pytest.mark.mounts]


def test_monitor_with_full_disk_reports_it_and_watches_on() -> None:
    failure = "less than 32 MB are left on the disk"
    with in_memory(300_000_000) as folder:
        with watching("--record", str(folder / "run.mcap"), "--snapshots", "--no-page") as (child, actor):
            actor.bus.subscribe(EVENTS.key())
            over = threading.Event()
            player = threading.Thread(target=play_until, args=(actor, over))
            player.start()
            try:
                until(lambda: read(folder / "run.mcap").extent().counts[ODOM.key("robot2")])
                fill(folder, leaving=20_000_000)
                result = snapshot_until(child, lambda one: one["recording_failure"] is not None)
                assert result["recording_failure"] == failure
                # the error is unknown while a position is late
                result = snapshot_until(child, lambda one: one["formation_error"] is not None)
                assert result["formation_error"] < 0.01
                assert result["recording_failure"] == failure
                assert has_end(folder / "run.mcap")
            finally:
                over.set()
                player.join()
            child.signal(signal.SIGTERM)
            summary = snapshot_until(child, lambda one: one["event"] == "summary")
            assert child.wait() == 1
            happened = [decode(LogEntry, one.payload) for one in actor.bus.drain()]
        assert [Path(one).name for one in summary["recording_parts"]] == ["run.mcap"]
        assert summary["recording_failure"] == failure
        recording = read(folder / "run.mcap")
        assert not recording.condition().is_cut
        assert recording.extent().counts == summary["recorded"]
        assert summary["recording_lost"] > 0
        assert summary["recorded"][ODOM.key("robot2")] < summary["received"][ODOM.key("robot2")]
    level, text = [(one.level, one.text) for one in happened if one.kind == "recording"][-1]
    assert level == 40
    assert "nothing is recorded any more: less than 32 MB are left" in text


def play_until(actor: Actor, enough: threading.Event) -> None:
    while not enough.is_set():
        actor.play(0.5)


def fill(folder: Path, leaving: int) -> None:
    """Fill the disk except for `leaving` [bytes]."""
    with (folder / "filler").open("wb") as file:
        for _ in range((300_000_000 - leaving) // 1_000_000):
            file.write(bytes(1_000_000))


def snapshot_until(child: Child, wanted: Any) -> dict[str, Any]:
    """Return the next snapshot or summary that is `wanted`."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        line = child._lines.get(timeout=PATIENCE)
        assert line is not None, child.errors
        result: dict[str, Any] = json.loads(line)
        if result["event"] == "summary" or wanted(result):
            assert wanted(result), "the monitor ended before"
            return result
    raise AssertionError("no such snapshot came")
