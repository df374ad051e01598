"""Messages on each key: count, rate, longest silence and latency; and from a robot's odometry to its command.

Latencies are differences between a stamp, on its sender's clock, and an arrival, on the recorder's: they
contain the offset of the two clocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from formation.mission.model import Mission
from formation.monitor.metrics.feed import finite
from formation.monitor.metrics.keys import OWN, Watched, watched
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.recording.recorder import is_stamped, stamp_of
from formation.monitor.report.thin import Quantiles
from formation.topics import CMD_VEL, ODOM, POSE, TABLE


@dataclass(frozen=True, slots=True)
class Key:
    """One key over a whole recording."""

    key: str
    topic: str
    robot: str
    """Empty for the monitor's own keys."""
    count: int
    rate: float | None
    """Messages per second between the first and the last."""
    promised: float | None
    """Promised rate [Hz]."""
    missed: int
    """As the monitor counts them: periods without a message in gaps of up to a second."""
    rejected: int
    gap: float | None
    """Longest time between two messages [s]; None without two."""
    gap_at: float | None
    """When that gap began [s]."""
    quiet: float | None
    """From the last message to the end of the recording [s]; None without a message."""
    clock: float | None
    """Median of arrival less stamp of the newest messages [s]."""


class _Tally:
    def __init__(self) -> None:
        self.count = 0
        self.first = self.last = math.nan
        self.gap = self.gap_at = math.nan


class Traffic:
    """Counts messages."""

    def __init__(self, mission: Mission) -> None:
        self._keys: dict[str, Watched] = {one.key: one for one in (*watched(mission), *OWN)}
        self._tallies = {key: _Tally() for key in self._keys}

    def count_message(self, key: str, at: float) -> None:
        """Count a message that arrived at `at` [s]."""
        tally = self._tallies.get(key)
        if tally is None:
            return
        gap = at - tally.last
        if not gap <= tally.gap and tally.count:  # the first gap is longer than none
            tally.gap, tally.gap_at = gap, tally.last
        if not tally.count:
            tally.first = at
        tally.count += 1
        tally.last = at

    def keys(
        self, snapshot: Snapshot, rejected: Mapping[str, int], start: float, end: float
    ) -> Iterator[Key]:
        """Yield every key of the mission, in the order of the topic table, in time since `start` [s]."""
        metrics = {key: one for robot in snapshot.robots.values() for key, one in robot.keys.items()}
        order = [topic.name for topic in TABLE]
        for key, one in sorted(self._keys.items(), key=lambda item: order.index(item[1].topic.name)):
            tally, known = self._tallies[key], metrics.get(key)
            span = tally.last - tally.first
            yield Key(
                key=key,
                topic=one.topic.name,
                robot=one.robot,
                count=tally.count,
                rate=(tally.count - 1) / span if span > 0.0 else None,
                promised=one.rate,
                missed=known.missed if known else 0,
                rejected=rejected.get(key, 0),
                gap=finite(tally.gap),
                gap_at=finite(tally.gap_at - start),
                quiet=finite(end - tally.last),
                clock=known.clock if known else None,
            )


@dataclass(frozen=True, slots=True)
class Delays:
    """Distribution of times [s]."""

    count: int
    median: float | None
    p99: float | None
    maximum: float | None

    @classmethod
    def of(cls, quantiles: Quantiles) -> Delays:
        """Return the distribution of `quantiles`; the maximum is over every value."""
        maximum = quantiles.maximum if quantiles.count else None
        return cls(quantiles.count, quantiles.percentile(0.5), quantiles.percentile(0.99), maximum)


class Latencies:
    """Arrival less stamp by topic, and odometry to command by robot."""

    def __init__(self, mission: Mission) -> None:
        keys = watched(mission)
        self._topics = {one.key: one.topic.name for one in keys if is_stamped(one.topic.type)}
        self._quantiles: dict[str, Quantiles] = {}
        self._answers = {name: Quantiles() for name in mission.followers}
        self._inputs = {
            (POSE if spec.localisation == "external" else ODOM).key(name): name
            for name, spec in mission.robots.items()
            if name != mission.leader
        }
        self._commands = {CMD_VEL.key(name): name for name in mission.followers}
        self._period = {name: 1.0 / mission.robots[name].rate for name in mission.followers}
        self._sent: dict[str, float] = {}

    def process_message(self, key: str, payload: bytes, wall: float) -> None:
        """Take one accepted message that arrived at `wall` [s, the recorder's clock]."""
        if key in self._commands:
            self._sent[self._commands[key]] = wall
        topic = self._topics.get(key)
        stamp = None if topic is None else stamp_of(payload)
        if topic is None or stamp is None:
            return
        late = wall - stamp / 1e9
        self._quantiles.setdefault(topic, Quantiles()).add(late)
        if key in self._inputs:
            self._answer(self._inputs[key], wall, late)

    @property
    def by_topic(self) -> Mapping[str, Delays]:
        """Return arrival less stamp by topic, in the order of the topic table."""
        return {
            topic.name: Delays.of(self._quantiles[topic.name])
            for topic in TABLE
            if topic.name in self._quantiles
        }

    @property
    def answers(self) -> Mapping[str, Delays]:
        """Return times from the stamp of an odometry (or pose) message to the arrival of its command."""
        return {name: Delays.of(quantiles) for name, quantiles in self._answers.items() if quantiles.count}

    def _answer(self, robot: str, wall: float, late: float) -> None:
        """Take an odometry message, which an agent repeats after its answer: the command precedes it."""
        sent = self._sent.pop(robot, None)
        if sent is not None and wall - sent < 0.5 * self._period[robot]:
            self._answers[robot].add(late - (wall - sent))
