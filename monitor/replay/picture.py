"""What is to be seen of a recording at a position: the figures, the error so far, and what has happened."""

from __future__ import annotations

import math
from collections import deque
from itertools import takewhile
from typing import NamedTuple

from formation.mission import Mission
from formation.rate import Rate
from formation.ros2.messages import LogEntry, Number, decode
from formation.topics import ERROR, EVENTS
from formation.wire import BadMessage, Now
from monitor.core import Numbered
from monitor.figures.events import from_message
from monitor.figures.metrics import Metrics
from monitor.figures.snapshot import Snapshot
from monitor.page.showing import HISTORY_RATE
from monitor.page.source import EVENTS as MOST_EVENTS
from monitor.page.source import HISTORY as MOST_HISTORY
from monitor.recording.reader import Recorded
from monitor.recording.rerun import Rerun

_ERROR, _EVENTS = ERROR.key(), EVENTS.key()


class End(NamedTuple):
    """How far a picture goes."""

    event: int
    """Number of the newest event."""
    at: float
    """Time of the newest error in its history [s, the recorder's system clock]."""


class Picture:
    """Made of all messages that it was given since its beginning."""

    def __init__(self, mission: Mission) -> None:
        self.history: deque[tuple[float, float]] = deque(maxlen=MOST_HISTORY)
        """The formation error [m] of moments [s, the recorder's system clock], two a second."""
        self.events: deque[Numbered] = deque(maxlen=MOST_EVENTS)
        """The newest, the oldest of them first."""
        self._rerun = Rerun(mission)
        self._happened = 0
        self._rate = Rate(HISTORY_RATE)

    @property
    def metrics(self) -> Metrics:
        """The figures."""
        return self._rerun.metrics

    @property
    def end(self) -> End:
        """How far it goes."""
        at = self.history[-1][0] if self.history else -math.inf
        return End(self._happened, at)

    def news(self, since: End) -> tuple[list[Numbered], list[tuple[float, float]]]:
        """Events, and errors, that have been added `since`."""
        events = takewhile(lambda one: one.number > since.event, reversed(self.events))
        errors = takewhile(lambda one: one[0] > since.at, reversed(self.history))
        return list(events)[::-1], list(errors)[::-1]

    def snapshot(self, position: float) -> Snapshot:
        """Everything there is to know at `position` [s, the recorder's system clock]."""
        return self.metrics.snapshot(Now(position, position))

    def take(self, message: Recorded) -> None:
        """Take the next message."""
        self._rerun.take(message)
        sample = message.sample
        try:
            if sample.key == _ERROR and self._rate.tick(message.wall):
                self.history.append((message.wall, decode(Number, sample.payload).value))
            elif sample.key == _EVENTS:
                self._happened += 1
                event = from_message(decode(LogEntry, sample.payload))
                self.events.append(Numbered(self._happened, event))
        except BadMessage:
            return  # of what the monitor itself said; the figures know nothing of it either
