"""Show the monitor on its page: a frame after every look, and every event."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from itertools import takewhile
from typing import Any

from formation.mission.model import Mission
from formation.monitor.core import Monitor, Numbered
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.recording.recorder import Recorder
from formation.monitor.web import frames
from formation.monitor.web.source import Source
from formation.transport.runtime.rate import Rate
from formation.wire import Now

HISTORY_RATE = 2.0
"""Rate of the formation error's history for new pages [Hz]."""
COMPLAINT_RATE = 0.1
"""Highest rate of log entries about a failing page [Hz]."""
_log = logging.getLogger(__name__)


class Showing:
    """Follow one monitor. Failures here are logged, and the monitor goes on."""

    def __init__(self, mission: Mission, monitor: Monitor, source: Source) -> None:
        self._mission, self._monitor, self._source = mission, monitor, source
        self._history, self._complaints = Rate(HISTORY_RATE), Rate(COMPLAINT_RATE)
        self._begun = math.inf
        self._shown: Snapshot | None = None
        self._reported = 0

    def step(self, now: Now, recorder: Recorder | None) -> None:
        """Show the news since the last step. Call it right after the monitor's step."""
        self._begun = min(self._begun, now.mono)
        try:
            self._events()
            self._frame(now, recorder)
        except Exception:  # noqa: BLE001 - the monitor must go on without a page
            if self._complaints.tick(now.mono):
                _log.exception("the page cannot be shown what is new")

    def _events(self) -> None:
        events = self._monitor.events
        news: list[Numbered] = list(takewhile(lambda one: one.number > self._reported, reversed(events)))
        for one in reversed(news):
            self._reported = one.number
            self._source.note(frames.event(one.number, one.event))

    def _frame(self, now: Now, recorder: Recorder | None) -> None:
        snapshot = self._monitor.snapshot
        if snapshot is None or snapshot is self._shown:
            return
        self._shown = snapshot
        if self._history.tick(now.mono):
            self._source.observe(now.wall, snapshot.formation_error)
        if self._source.wanted:
            recording = _recording(recorder, now.mono - self._begun)
            metrics = self._monitor.metrics
            frame = frames.frame(self._mission, metrics, now, snapshot=snapshot, recording=recording)
            self._source.show(frame, snapshot)


def _recording(recorder: Recorder | None, seconds: float) -> Mapping[str, Any] | None:
    """Return the state of a recording, begun `seconds` ago."""
    if recorder is None:
        return None
    path, failure = str(recorder.paths[-1]), recorder.failure
    return {"path": path, "bytes": recorder.bytes, "seconds": round(seconds, 1), "failure": failure}
