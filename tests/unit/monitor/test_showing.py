from __future__ import annotations

import asyncio
import json
import logging
from pathlib import Path
from typing import Any, cast

import httpx
import pytest

from formation.monitor.core import Monitor
from formation.monitor.metrics.event import INFO, Event
from formation.monitor.process import PageUpdater
from formation.monitor.recording.recorder import Recorder
from formation.monitor.web.routes import application
from formation.monitor.web.source import Source
from formation.monitor.web.stream import Streams
from tests.support.looking import source
from tests.support.monitored import EPOCH, Fleet, now


class Watched:
    """A monitor of a fleet without errors, and its source for the page."""

    def __init__(self, one: Source, recorder: Recorder | None = None) -> None:
        self.fleet = Fleet()
        self.monitor = Monitor(self.fleet.mission)
        self.source, self.frames = one, 0
        self._showing, self._recorder = PageUpdater(self.fleet.mission, self.monitor, one), recorder
        one.set_wake(self._count)

    def run(self, start: float, end: float) -> None:
        """Step fifty times a second."""
        samples = self.fleet.positions(start, end)
        for tick in range(round((end - start) * 50)):
            mono = start + tick / 50
            self.monitor.step(now(mono), [s for s in samples if mono - 0.02 < s.arrived <= mono])
            self._showing.step(now(mono), self._recorder)

    def shown(self) -> Any:
        look = self.source.look
        assert look is not None
        return look.frame

    def greeting(self) -> Any:
        return json.loads(self.source.greeting().chunk.decode().partition("data: ")[2])

    def _count(self) -> None:
        if self.source.look is not None:
            self.frames = self.source.look.number


def test_viewer_gets_ten_frames_a_second() -> None:
    watched = Watched(source())
    watched.source.set_clients(1)
    watched.run(10.0, 20.0)
    assert 98 <= watched.frames <= 101
    assert watched.shown()["t"] - EPOCH == pytest.approx(20.0, abs=0.11)
    assert watched.shown()["error"] == 0.0


def test_history_and_events_are_kept_without_viewers() -> None:
    watched = Watched(source())
    watched.run(10.0, 20.0)
    assert watched.source.look is None
    reported = watched.greeting()
    assert 19 <= len(reported["history"]) <= 21
    assert reported["history"][-1][1] == 0.0
    assert {event["kind"] for event in reported["events"]} >= {"joined", "settled"}


def test_greeting_lists_every_event_once_in_order() -> None:
    watched = Watched(source())
    watched.run(10.0, 11.0)
    watched.monitor.note(Event(1011.0, INFO, "", "operator", "stop: all have obeyed"))
    watched.run(11.0, 12.0)
    numbers = [event["n"] for event in watched.greeting()["events"]]
    assert numbers == list(range(1, len(watched.monitor.events) + 1))
    assert "operator" in {event["kind"] for event in watched.greeting()["events"]}


class Disk:
    """A recorder with only what the page shows."""

    paths, bytes = (Path("a.mcap"), Path("a_2.mcap")), 4711
    failure: str | None = None


def test_frame_shows_recording_size_duration_and_failure() -> None:
    disk = Disk()
    watched = Watched(source(), cast("Recorder", disk))
    watched.source.set_clients(1)
    watched.run(10.0, 12.0)
    assert watched.shown()["recording"] == {
        "path": "a_2.mcap", "bytes": 4711, "seconds": pytest.approx(2.0, abs=0.11), "failure": None,
    }  # fmt: skip
    disk.failure = "No space left on device"
    watched.run(12.0, 12.2)
    assert watched.shown()["recording"]["failure"] == "No space left on device"


def test_failing_page_is_logged_and_monitor_continues(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = Watched(source())
    watched.source.set_clients(1)

    def fails(*_: object) -> None:
        raise RuntimeError("no page today")

    monkeypatch.setattr(watched.source, "show", fails)
    with caplog.at_level(logging.ERROR):
        watched.run(10.0, 15.0)
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert "no page today" in caplog.text
    assert watched.monitor.snapshot is not None
    assert watched.monitor.snapshot.converged


def health(one: Source) -> httpx.Response:
    app = application(one, Streams(one, lambda _: None), None, None)

    async def answer() -> httpx.Response:
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app), base_url="http://localhost"
        ) as client:
            return await client.get("/healthz")

    return asyncio.run(answer())


def test_health_is_503_once_newest_step_is_2_s_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter((0.0, 1.0, 3.0, 3.1, 4.0, 6.0, 7.0)).__next__  # created, then as in the lines below
    watched = Watched(source(clock))
    watched.run(10.0, 10.02)
    assert health(watched.source).text == "ok\n"
    answer = health(watched.source)
    assert answer.status_code == 503
    assert answer.json() == {"error": "the newest step of the monitor is 2.1 s old"}
    watched.run(10.02, 10.04)
    assert health(watched.source).status_code == 200
    watched.source.set_clients(1)
    monkeypatch.setattr(watched.source, "show", {}.__getitem__)  # fails: no frame is made
    watched.run(11.0, 11.02)
    assert health(watched.source).status_code == 503
