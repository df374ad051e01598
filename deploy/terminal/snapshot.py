"""What `formation run` and `formation watch` show: the monitor's snapshots, and the run so far."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

from formation.mission.model import Mission
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.settling import KnownError, KnownVerdict

MAX_ERRORS = 7200
"""Number of values of the formation error in a picture: half an hour at four a second."""
MAX_EVENTS = 50
"""Number of newest events kept: more than a terminal has lines."""


class RobotNow(NamedTuple):
    """The monitor's last values of one robot; None means unknown."""

    state: str = ""
    error: float | None = None
    """Error summed over its neighbours [m]."""
    speed: float | None = None
    """Commanded speed [m/s]."""
    turn_rate: float | None = None
    """Commanded turn rate [rad/s]."""
    heading_error: float | None = None
    """Estimated less true heading [rad]."""
    age: float | None = None
    """Age of its last position [s]."""
    unavailable: bool = False
    """Whether it is unavailable: it does not follow, and others go on without it."""
    stuck: bool = False
    """Whether it does not move although commanded to."""
    avoiding: str = ""
    """Limit on its law's command, in a word: ``avoids``, ``slowed`` or ``blocked``."""
    fallback: str = ""
    """Fallback neighbours that it follows."""
    known_error: float | None = None
    """Error summed over its known neighbours [m]: at most `error`."""

    @classmethod
    def of(cls, robot: Mapping[str, Any]) -> RobotNow:
        """Read one robot of a snapshot of the monitor."""
        return cls(**{name: robot[name] for name in cls._fields[:-1]}, known_error=robot["known"][0])


class Snapshot(NamedTuple):
    """The formation as the monitor saw it at one time."""

    error: float
    """Formation error, summed over all edges [m]; NaN while a position is missing."""
    robots: Mapping[str, RobotNow]
    events: tuple[Event, ...] = ()
    """Events since the last snapshot."""
    leads: str | None = None
    """The leading candidate; None if there is none, or it is unknown."""
    waits: str = ""
    """Robots that the leader waits for."""
    placed_shape: str = ""
    """Rotation and scale of the shape, and whether it is changing."""
    partial: KnownError | None = None
    """The error over the known edges, if some are known but not all."""
    candidates: Mapping[str, str] = MappingProxyType({})
    """State of each candidate, by rank; empty if there are no standbys."""

    @property
    def known_error(self) -> float:
        """The error over the known edges, all or some [m]; NaN if there are none."""
        return self.error if self.partial is None or self.partial.error is None else self.partial.error

    @classmethod
    def of(cls, event: Mapping[str, Any]) -> Snapshot:
        """Read a snapshot of the monitor, as `formation.monitor.metrics.words.as_json` gives it."""
        error, known = event["formation_error"], KnownVerdict.of_json(event["known"]).final
        return cls(
            math.nan if error is None else error,
            {name: RobotNow.of(robot) for name, robot in event["robots"].items()},
            tuple(Event(**one) for one in event.get("events", ())),
            event["leads"],
            event["waits"],
            _placed_shape(event),
            known if error is None and known is not None and known.error is not None else None,
            {name: one["state"] for name, one in event["candidates"].items()},
        )


NOTHING_KNOWN = Snapshot(math.nan, {})


@dataclass(slots=True)
class Progress:
    """The run so far."""

    mission: Mission
    duration: float | None = None
    """Duration of the run [s]; None without an end."""
    processes: int = 0
    """Number of processes of the run; 0 if a fleet is only watched."""
    phase: str = "starting"
    ready: int = 0
    elapsed: float = 0.0
    """Time since all were ready, or since the watching began [s]."""
    note: str = ""
    """Text to show while there is no snapshot."""
    snapshot: Snapshot | None = None
    errors: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_ERRORS))
    """Formation error of every snapshot so far, over the edges that were known [m]."""
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=MAX_EVENTS))
    """Events, the newest last."""
    dead: dict[str, str] = field(default_factory=dict)
    """Processes that ended without a request, and how."""
    dead_robots: set[str] = field(default_factory=set)
    """Robots with an agent among them."""

    @property
    def settled(self) -> bool:
        """Whether the error over the known edges is under the mission's bound now."""
        return self.snapshot is not None and self.snapshot.known_error < self.mission.settled

    @property
    def left(self) -> float:
        """Remaining time [s]."""
        return math.inf if self.duration is None else self.duration - self.elapsed

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Take a snapshot of the monitor."""
        self.snapshot = snapshot
        self.events.extend(snapshot.events)
        if math.isfinite(snapshot.known_error):
            self.errors.append(snapshot.known_error)

    def forget_snapshot(self) -> None:
        """Forget the current values after the monitor's end, so that old ones are not shown as current."""
        self.snapshot = NOTHING_KNOWN


def _placed_shape(event: Mapping[str, Any]) -> str:
    """Return the shape in words, unless it is as drawn: ``wedge turned by 30°, × 1.5, on its way``."""
    rotation, scale = event["rotation"], event["scale"]
    parts = [
        f"turned by {math.degrees(rotation):.3g}°" if rotation else "",
        f"{scale:.3g} times as large" if scale not in {None, 1.0} else "",
        "" if event["formed"] else "on its way",
    ]
    details = ", ".join(filter(None, parts))
    return f"{event['shape']} {details}" if details else ""
