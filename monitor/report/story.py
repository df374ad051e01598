"""What happened in a recording: the monitor's events, and what the leader ordered."""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.order import Mode
from formation.ros2.messages import Diagnostics, LogEntry, decode
from formation.topics import DIAGNOSTICS, EVENTS
from formation.wire import BadMessage
from monitor.figures.events import Event, from_message
from monitor.figures.metrics import Metrics
from monitor.figures.orders import Wish

SETTLED = b"settled at"
MOST = 2000
"""Events, and changes of the order, that are kept; more are only counted."""


class Ordered(NamedTuple):
    """What the leader wanted from this moment on."""

    at: float
    """[s, the recorder's clock]"""
    mode: Mode
    wish: Wish
    leads: str
    """Whose order it was."""

    @property
    def shape(self) -> str:
        """That is wished for."""
        return self.wish.shape


class Story:
    """Collects what happens."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.orders: list[Ordered] = []
        self.untold = 0
        """Events that were not kept."""
        self.apart = math.nan
        """By how much the monitor's own settling time was longer when it last told it [s]."""

    def take(self, key: str, payload: bytes) -> None:
        """Take a message, if it tells of an event."""
        if key != EVENTS.key():
            return
        try:
            entry = decode(LogEntry, payload)
        except BadMessage:
            return
        if len(self.events) < MOST:
            self.events.append(from_message(entry))
        else:
            self.untold += 1

    def check(self, key: str, payload: bytes, settled_at: float | None) -> None:
        """Compare the settling time that the monitor told then with the one found now [s].

        Live it runs on the monotonic clock, which a recording does not know.
        """
        if key != DIAGNOSTICS.key() or settled_at is None or SETTLED not in payload:
            return
        try:
            values = decode(Diagnostics, payload).statuses[0].values
            self.apart = float(values.get("settled at", "nan")) - settled_at
        except (BadMessage, IndexError, ValueError):
            return

    def look(self, wall: float, metrics: Metrics) -> None:
        """See whether the order has changed by `wall` [s]."""
        order = metrics.order
        if order is None or len(self.orders) >= MOST:
            return
        wanted = order.mode, Wish.of(order), metrics.lead.name if metrics.lead else ""
        if not self.orders or self.orders[-1][1:] != wanted:
            self.orders.append(Ordered(wall, *wanted))
