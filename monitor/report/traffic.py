"""Messages on each key: count, rate, longest silence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN, Watched, watched
from formation.monitor.metrics.snapshot import Snapshot
from formation.topics import TABLE


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

    @property
    def missed_share(self) -> float | None:
        """Share of the expected messages that were missed."""
        return self.missed / (self.missed + self.count) if self.count else None


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

    def count_message(self, key: str, wall: float) -> None:
        """Count a message that arrived at `wall` [s]."""
        tally = self._tallies.get(key)
        if tally is None:
            return
        gap = wall - tally.last
        if not gap <= tally.gap and tally.count:  # the first gap is longer than none
            tally.gap, tally.gap_at = gap, tally.last
        if not tally.count:
            tally.first = wall
        tally.count += 1
        tally.last = wall

    def keys(
        self, snapshot: Snapshot, rejected: Mapping[str, int], start: float, end: float
    ) -> Iterator[Key]:
        """Every key of the mission, in the order of the topic table, in time since `start` [s]."""
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
                gap=_finite(tally.gap),
                gap_at=_finite(tally.gap_at - start),
                quiet=_finite(end - tally.last),
                clock=known.clock if known else None,
            )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
