"""A monotonic time for the messages of a recording: they arrived by a system clock that may have been set."""

from __future__ import annotations

import math

from formation.monitor.metrics.event import clock_step, from_message
from formation.ros2.messages import LogEntry, decode
from formation.topics import EVENTS
from formation.wire import BadMessage

MAX_DISORDER = 0.1
"""Largest step back of the arrivals on one key that is no sign of a clock that was set [s]."""


class Timeline:
    """The recorder's system clock as if it had not been set. Pass the messages in the order of the file.

    The monitor's events say by how much it was set. In a recording without them a step back shows in the
    arrivals on a key, to within the time between two messages; a step forward looks like a pause, and stays.
    """

    def __init__(self) -> None:
        self._ahead = 0.0  # the system clock before this time [s]
        self._newest = -math.inf
        self._last: dict[str, float] = {}  # by key

    def moment(self, key: str, payload: bytes, wall: float) -> float:
        """Return the time [s] of the next message, which arrived at `wall` [s, recorder's system clock]."""
        if key == EVENTS.key():
            self._ahead += _step(payload)
        moment = wall - self._ahead
        if moment < self._last.get(key, -math.inf) - MAX_DISORDER:
            moment, self._ahead = self._newest, wall - self._newest
        self._last[key], self._newest = moment, max(self._newest, moment)
        return moment


def _step(payload: bytes) -> float:
    try:
        return clock_step(from_message(decode(LogEntry, payload)))
    except BadMessage:
        return 0.0
