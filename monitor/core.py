"""The monitor without a clock, a socket or a file: what was heard in, what it publishes out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from formation.mission import Mission
from formation.rate import Rate
from formation.ros2.messages import Number, encode
from formation.topics import DIAGNOSTICS, ERROR, EVENTS, Topic
from formation.wire import Now, Outgoing, Sample
from monitor.figures.events import Event, Events, to_message
from monitor.figures.keys import OWN, watched
from monitor.figures.metrics import Metrics
from monitor.figures.snapshot import Snapshot
from monitor.figures.words import diagnostics

REMEMBERED = 1000
"""Newest events that are kept for whoever looks later; all are in the recording."""


class Numbered(NamedTuple):
    """An event and which one of the run it is, from 1."""

    number: int
    event: Event


class Monitor:
    """Watches one mission's fleet. It publishes figures about it and nothing that any robot listens to."""

    def __init__(self, mission: Mission, stage: Iterable[str] = ()) -> None:
        """`stage` has the robots that are simulated: only of them the truth is to be had."""
        self.metrics = Metrics(mission)
        self.snapshot: Snapshot | None = None
        """Of the last look, a tenth of a second old at most; None before the first."""
        self.events: deque[Numbered] = deque(maxlen=REMEMBERED)
        """The newest, the oldest of them first."""
        self._events = Events(mission)
        self._noted: deque[Event] = deque()
        self._happened = 0
        self._stage = frozenset(stage)
        self._keys = watched(mission)
        self._error_rate, self._diagnostics_rate = Rate(10.0), Rate(1.0)

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key that it publishes."""
        return tuple((one.topic, one.key) for one in OWN)

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Every key that it listens to on the fleet's bus, in the order of subscribing."""
        return tuple(one.key for one in self._keys if not one.on_stage)

    @property
    def truths(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key that it listens to on the stage."""
        return tuple((one.topic, one.key) for one in self._keys if one.on_stage and one.robot in self._stage)

    def note(self, event: Event) -> None:
        """Have an event of which the fleet's messages say nothing join the others. For any thread."""
        self._noted.append(event)

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Learn from `inbox`; the figures that are due. An error that is not known is not published."""
        ahead = now.wall - now.mono
        for sample in inbox:
            self.metrics.take(sample, sample.arrived + ahead)
        outbox = []
        if self._error_rate.tick(now.mono):
            error = self.metrics.observe(now)
            if error is not None:
                outbox.append(Outgoing(ERROR.key(), encode(Number(error))))
            self.snapshot = self.metrics.snapshot(now)
            self._noted.extend(self._events.see(now, self.snapshot))
        outbox += self._tell()
        if self._diagnostics_rate.tick(now.mono):
            snapshot = self.metrics.snapshot(now)
            outbox += [Outgoing(DIAGNOSTICS.key(), encode(one)) for one in diagnostics(snapshot, now.wall)]
        return outbox

    def _tell(self) -> list[Outgoing]:
        """Number what has happened, keep it and publish it."""
        outbox = []
        while self._noted:
            event = self._noted.popleft()
            self._happened += 1
            self.events.append(Numbered(self._happened, event))
            outbox.append(Outgoing(EVENTS.key(), encode(to_message(event))))
        return outbox
