"""The history in a recording: the monitor's events, and the leader's orders."""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.monitor.metrics.events import Event, from_message
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.orders import Wish
from formation.protocol.order import Mode
from formation.ros2.messages import Diagnostics, LogEntry, decode
from formation.topics import DIAGNOSTICS, EVENTS
from formation.wire import BadMessage

SETTLED = b"settled_at"
MAX_EVENTS = 2000
"""Most events, and changes of the order, that are kept; more are only counted."""


class Ordered(NamedTuple):
    """The leader's order from this moment on."""

    at: float
    """[s, the recorder's clock]"""
    mode: Mode
    wish: Wish
    leads: str
    """Name of the candidate that gave it."""

    @property
    def shape(self) -> str:
        """The requested shape."""
        return self.wish.shape


class Story:
    """Collect the history."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.orders: list[Ordered] = []
        self.unlisted = 0
        """Number of events not kept."""
        self.apart = math.nan
        """Excess of the settling time last published by the monitor [s]."""

    def process_message(self, key: str, payload: bytes) -> None:
        """Take a message, if it is an event."""
        if key != EVENTS.key():
            return
        try:
            entry = decode(LogEntry, payload)
        except BadMessage:
            return
        if len(self.events) < MAX_EVENTS:
            self.events.append(from_message(entry))
        else:
            self.unlisted += 1

    def check(self, key: str, payload: bytes, settled_at: float | None) -> None:
        """Compare the settling time that the monitor published with the one found now [s].

        The live one is on the monotonic clock, which is not in a recording.
        """
        if key != DIAGNOSTICS.key() or settled_at is None or SETTLED not in payload:
            return
        try:
            values = decode(Diagnostics, payload).statuses[0].values
            self.apart = float(values.get("settled_at", "nan")) - settled_at
        except (BadMessage, IndexError, ValueError):
            return

    def look(self, wall: float, metrics: Metrics) -> None:
        """Note a change of the order by `wall` [s]."""
        order = metrics.order
        if order is None or len(self.orders) >= MAX_EVENTS:
            return
        wanted = order.mode, Wish.of(order), metrics.lead.name if metrics.lead else ""
        if not self.orders or self.orders[-1][1:] != wanted:
            self.orders.append(Ordered(wall, *wanted))
