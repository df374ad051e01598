"""What the monitor shows on its page: a frame whenever it has looked, and every event."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from itertools import takewhile
from typing import Any

from formation.mission import Mission
from formation.rate import Rate
from formation.wire import Now
from monitor.core import Monitor, Numbered
from monitor.figures.snapshot import Snapshot
from monitor.page import frames
from monitor.page.source import Source
from monitor.recording.recorder import Recorder

HISTORY_RATE = 2.0
"""Of the formation error that new pages are given [Hz]."""
COMPLAINTS = 0.1
"""A page that fails is told of so often [Hz]."""
_log = logging.getLogger(__name__)


class Showing:
    """Follows one monitor. Whatever goes wrong here is logged, and the monitor goes on."""

    def __init__(self, mission: Mission, monitor: Monitor, source: Source) -> None:
        self._mission, self._monitor, self._source = mission, monitor, source
        self._history, self._complaints = Rate(HISTORY_RATE), Rate(COMPLAINTS)
        self._begun = math.inf
        self._shown: Snapshot | None = None
        self._told = 0

    def step(self, now: Now, recorder: Recorder | None) -> None:
        """Show what is new since the last step. Call it right after the monitor's."""
        self._begun = min(self._begun, now.mono)
        try:
            self._events()
            self._frame(now, recorder)
        except Exception:  # noqa: BLE001 - to be looked at is not what a monitor is for
            if self._complaints.tick(now.mono):
                _log.exception("the page cannot be shown what is new")

    def _events(self) -> None:
        events = self._monitor.events
        news: list[Numbered] = list(takewhile(lambda one: one.number > self._told, reversed(events)))
        for one in reversed(news):
            self._told = one.number
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
    """How a recording stands that was begun so many seconds ago."""
    if recorder is None:
        return None
    path, failure = str(recorder.paths[-1]), recorder.failure
    return {"path": path, "bytes": recorder.bytes, "seconds": round(seconds, 1), "failure": failure}
