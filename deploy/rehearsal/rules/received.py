"""What each agent and each candidate has received, by the rehearsal's own clock."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

from formation.deploy.rehearsal.engine import VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.protocol import json_message, order
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.topics import POSITION
from formation.wire import Outgoing

MEMORY_TIME = 50.0
"""Time for which the quickest message counts [s]: later a constant delay is the normal one."""


class Newest(NamedTuple):
    """Messages of one key at one process."""

    arrived: float = -math.inf
    """When the newest arrived [s]."""
    sent: float = -math.inf
    """When the newest of those that arrived was published [s]."""
    quickest: float = math.inf
    """Least delay of a message [s] …"""
    since: float = -math.inf
    """… and when that message arrived [s]."""

    def after(self, sent: float, now: float) -> Newest:
        """The same after one more, published at `sent`, that arrives `now` [s]."""
        delay = now - sent
        quick = delay <= self.quickest or now - self.since > MEMORY_TIME
        return Newest(now, max(sent, self.sent), *((delay, now) if quick else (self.quickest, self.since)))


@dataclass
class OrdersReceived:
    """The orders that one process has received."""

    beats: dict[tuple[str, int], int] = field(default_factory=dict)
    """The newest beat of each key and term."""
    risen: set[int] = field(default_factory=set)
    """Terms with a beat that has risen at one key."""
    rose: float = -math.inf
    """When a beat last rose at a key [s]."""
    newest: Order | None = None

    def add(self, key: str, received: Order, now: float) -> None:
        """Add one that arrived on `key` now [s]."""
        before = self.beats.get((key, received.term))
        if before is not None and received.beat > before:
            self.risen.add(received.term)
            self.rose = now
        self.beats[key, received.term] = received.beat
        if order.newer(received, self.newest):
            self.newest = received


class Received:
    """What the processes of one fleet have received."""

    def __init__(self, fleet: Fleet) -> None:
        self.newest: defaultdict[VirtualProcess, dict[str, Newest]] = defaultdict(dict)
        """By key."""
        self.orders: defaultdict[VirtualProcess, OrdersReceived] = defaultdict(OrdersReceived)
        self.publishers: defaultdict[VirtualProcess, dict[str, tuple[str, float]]] = defaultdict(dict)
        """The newest publisher of each robot's positions, and since when its messages arrive [s]."""
        self.repeated: Counter[tuple[VirtualProcess, str]] = Counter()
        """Number of messages of a key that arrived again, or after newer ones."""
        self.ordered: dict[tuple[int, int], float] = {}
        """When each term and beat was first published [s]."""
        self._engine, self._tag = fleet.engine, fleet.mission.tag
        self._positions = frozenset(POSITION.key(name) for name in fleet.mission.names)
        self._leader = POSITION.key(fleet.mission.leader)
        fleet.fleet.watchers.append(self._publish)
        for exchange in (fleet.fleet, fleet.local):
            exchange.receivers.append(self._note)

    def _publish(self, process: VirtualProcess, out: Outgoing) -> None:
        if out.key == self._leader and out.attachment is not None and process.name.startswith("leader "):
            ordered = attachment_of(out.attachment).order
            if ordered is not None:
                self.ordered.setdefault((ordered.term, ordered.beat), self._engine.now)

    def _note(self, process: VirtualProcess, out: Outgoing, sent: float) -> None:
        if not process.name.startswith(("agent ", "leader ")):
            return
        now, newest = self._engine.now, self.newest[process]
        if out.key in newest and sent <= newest[out.key].sent:
            self.repeated[process, out.key] += 1
        newest[out.key] = newest.get(out.key, Newest()).after(sent, now)
        if out.key not in self._positions or out.attachment is None:
            return
        attachment = attachment_of(out.attachment)
        if attachment.order is not None:
            self.orders[process].add(out.key, attachment.order, now)
        known = self.publishers[process].get(out.key)
        if attachment.mission == self._tag and (known is None or known[0] != attachment.publisher_id):
            self.publishers[process][out.key] = attachment.publisher_id, now


@lru_cache(maxsize=64)
def attachment_of(data: bytes) -> PositionAttachment:
    """Decode what came with a position; it is received by several processes."""
    return json_message.decode(PositionAttachment, data)
