"""The monitor without a clock, a socket or a file: what was heard in, what it publishes out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from formation.mission import Mission
from formation.rate import Rate
from formation.ros2.messages import Number, encode
from formation.topics import DIAGNOSTICS, ERROR, Topic
from formation.wire import Now, Outgoing, Sample
from monitor.figures.keys import OWN, watched
from monitor.figures.metrics import Metrics
from monitor.figures.words import diagnostics


class Monitor:
    """Watches one mission's fleet. It publishes figures about it and nothing that any robot listens to."""

    def __init__(self, mission: Mission, stage: Iterable[str] = ()) -> None:
        """`stage` has the robots that are simulated: only of them the truth is to be had."""
        self.metrics = Metrics(mission)
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
        if self._diagnostics_rate.tick(now.mono):
            snapshot = self.metrics.snapshot(now)
            outbox += [Outgoing(DIAGNOSTICS.key(), encode(one)) for one in diagnostics(snapshot, now.wall)]
        return outbox
