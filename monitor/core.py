"""The monitor without a clock, a socket or a file: received messages in, messages to publish out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Reversible, Sequence
from itertools import takewhile
from typing import Any, NamedTuple, TypeVar

from formation.mission.model import Mission
from formation.monitor.metrics.event import WARNING, Event, clock_set, to_message
from formation.monitor.metrics.events import Events
from formation.monitor.metrics.keys import watched
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import diagnostics
from formation.ros2.messages import Number, encode
from formation.topics import DIAGNOSTICS, ERROR, EVENTS, Topic
from formation.transport.runtime.rate import Rate
from formation.wire import Now, Outgoing, Sample

MAX_EVENTS = 1000
"""Number of newest events that are kept; all are in the recording."""
MIN_CLOCK_STEP = 0.1
"""Smallest step of our system clock against the monotonic one that is reported [s]."""
MAX_STEP_TIME = 1.0
"""Longest time between two steps of a monitor that was not frozen [s]. After a longer one no event is judged
for as long: messages of that time arrive late, if at all."""
T = TypeVar("T", bound=tuple[Any, ...])


class NumberedEvent(NamedTuple):
    """An event and its number in the run, from 1."""

    number: int
    event: Event


def newer_than(items: Reversible[T], mark: float) -> list[T]:
    """Return the items with a first field above `mark`, in order; first fields rise."""
    return list(takewhile(lambda one: one[0] > mark, reversed(items)))[::-1]


class Monitor:
    """Watch one mission's fleet. Publishes metrics about it and nothing that a robot listens to."""

    def __init__(self, mission: Mission, stage: Iterable[str] = ()) -> None:
        """`stage` has the simulated robots: only they have ground truth."""
        self.metrics = Metrics(mission)
        self.snapshot: Snapshot | None = None
        """The last one, at most 0.1 s old; None before the first."""
        self.events: deque[NumberedEvent] = deque(maxlen=MAX_EVENTS)
        """The newest events, oldest first."""
        self._events = Events(mission)
        self._noted: deque[Event] = deque()
        self._event_count = 0
        self._ahead: float | None = None  # our system clock before the monotonic one [s]
        self._stepped = self._events_from = -math.inf  # [s, monotonic]
        self._stage = frozenset(stage)
        self._keys = watched(mission)
        self._error_rate, self._diagnostics_rate = Rate(10.0), Rate(1.0)

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Every key that it listens to on the fleet's bus, in the order of subscribing."""
        return tuple(one.key for one in self._keys if not one.on_stage)

    @property
    def truth_topics(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key that it listens to on the stage."""
        return tuple((one.topic, one.key) for one in self._keys if one.on_stage and one.robot in self._stage)

    def note(self, event: Event) -> None:
        """Add an event that is not from the fleet's messages. Any thread may call it."""
        self._noted.append(event)

    def watch_clock(self, now: Now) -> list[Outgoing]:
        """Return the event to publish if our system clock was set since the last call.

        It is to be recorded before messages that arrived since, so that readers know of the step first.
        """
        before, self._ahead = self._ahead, now.wall - now.mono
        if before is None or abs(self._ahead - before) < MIN_CLOCK_STEP:
            return []
        self.note(clock_set(now.wall, self._ahead - before))
        return list(self._noted_events())

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Read `inbox` and return the metrics that are due. An unknown error is not published."""
        outbox = self.watch_clock(now)
        self._note_pause(now)
        ahead = now.wall - now.mono
        for sample in inbox:
            self.metrics.process_sample(sample, sample.arrived + ahead)
        if self._error_rate.tick(now.mono):
            error = self.metrics.observe(now)
            if error is not None:
                outbox.append(Outgoing(ERROR.key(), encode(Number(error))))
            self.snapshot = self.metrics.snapshot(now)
            if now.mono >= self._events_from:
                self._noted.extend(self._events.collect_events(now, self.snapshot))
        outbox += self._noted_events()
        if self._diagnostics_rate.tick(now.mono):
            snapshot = self.metrics.snapshot(now)
            outbox += [Outgoing(DIAGNOSTICS.key(), encode(one)) for one in diagnostics(snapshot, now.wall)]
        return outbox

    def _note_pause(self, now: Now) -> None:
        """Note that this process was frozen; no events are judged until messages arrive again."""
        pause, self._stepped = now.mono - self._stepped, now.mono
        if not MAX_STEP_TIME < pause < math.inf:
            return
        self._events_from = now.mono + MAX_STEP_TIME
        text = f"the monitor was frozen for {pause:.1f} s, limit {MAX_STEP_TIME:g} s"
        self.note(Event(now.wall, WARNING, "", "frozen", f"{text}; messages of that time may be missing"))

    def _noted_events(self) -> Iterator[Outgoing]:
        while self._noted:
            event = self._noted.popleft()
            self._event_count += 1
            self.events.append(NumberedEvent(self._event_count, event))
            yield Outgoing(EVENTS.key(), encode(to_message(event)))
