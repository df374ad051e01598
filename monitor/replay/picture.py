"""The state of a recording at a position: the metrics, the error so far, and the events."""

from __future__ import annotations

import math
from collections import deque
from itertools import takewhile
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.core import Numbered
from formation.monitor.metrics.events import from_message
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.recording.reader import Recorded
from formation.monitor.recording.rerun import Rerun
from formation.monitor.web.showing import HISTORY_RATE
from formation.monitor.web.source import HISTORY_VALUES as MOST_HISTORY
from formation.monitor.web.source import MAX_EVENTS as MOST_EVENTS
from formation.ros2.messages import LogEntry, Number, decode
from formation.topics import ERROR, EVENTS
from formation.transport.runtime.rate import Rate
from formation.wire import BadMessage, Now

_ERROR, _EVENTS = ERROR.key(), EVENTS.key()


class End(NamedTuple):
    """The end of a picture."""

    event: int
    """Number of the newest event."""
    at: float
    """Time of the newest error in its history [s, the recorder's system clock]."""


class Picture:
    """Built from all messages since its beginning."""

    def __init__(self, mission: Mission) -> None:
        self.history: deque[tuple[float, float]] = deque(maxlen=MOST_HISTORY)
        """The formation error [m] of moments [s, the recorder's system clock], two a second."""
        self.events: deque[Numbered] = deque(maxlen=MOST_EVENTS)
        """The newest events, oldest first."""
        self._rerun = Rerun(mission)
        self._happened = 0
        self._rate = Rate(HISTORY_RATE)

    @property
    def metrics(self) -> Metrics:
        """The metrics."""
        return self._rerun.metrics

    @property
    def end(self) -> End:
        """Its current end."""
        at = self.history[-1][0] if self.history else -math.inf
        return End(self._happened, at)

    def news(self, since: End) -> tuple[list[Numbered], list[tuple[float, float]]]:
        """Return the events and errors added `since`."""
        events = takewhile(lambda one: one.number > since.event, reversed(self.events))
        errors = takewhile(lambda one: one[0] > since.at, reversed(self.history))
        return list(events)[::-1], list(errors)[::-1]

    def snapshot(self, position: float) -> Snapshot:
        """Return everything known at `position` [s, the recorder's system clock]."""
        return self.metrics.snapshot(Now(position, position))

    def process_message(self, message: Recorded) -> None:
        """Take in the next message."""
        self._rerun.process_message(message)
        sample = message.sample
        try:
            if sample.key == _ERROR and self._rate.tick(message.wall):
                self.history.append((message.wall, decode(Number, sample.payload).value))
            elif sample.key == _EVENTS:
                self._happened += 1
                event = from_message(decode(LogEntry, sample.payload))
                self.events.append(Numbered(self._happened, event))
        except BadMessage:
            return  # of the monitor's own messages, which the metrics do not use either
