"""A run as far as it has come, or a fleet as far as it was watched: what there is to be shown of it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from deploy.terminal.snapshot import Snapshot
from formation.mission import Mission
from monitor.figures.events import Event

ERRORS = 7200
"""Values of the formation error that a picture is made of: half an hour at four a second."""
EVENTS = 50
"""Newest events that are kept: more than a terminal has lines."""


@dataclass(slots=True)
class Progress:
    """The run so far."""

    mission: Mission
    duration: float | None = None
    """[s]; None without an end."""
    processes: int = 0
    """Of the run; none where a fleet is only watched."""
    phase: str = "starting"
    ready: int = 0
    elapsed: float = 0.0
    """[s] since all were ready, or since the watching began."""
    note: str = ""
    """What to say as long as there is no snapshot."""
    snapshot: Snapshot | None = None
    errors: deque[float] = field(default_factory=lambda: deque(maxlen=ERRORS))
    """Formation error of every snapshot so far, over the edges that were known [m]."""
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS))
    """What has happened, the newest last."""
    dead: dict[str, str] = field(default_factory=dict)
    """Processes that ended unasked, and how."""
    dead_robots: set[str] = field(default_factory=set)
    """Robots whose agent is one of them."""

    @property
    def settled(self) -> bool:
        """Whether the error over the known edges is under the mission's bound just now."""
        return self.snapshot is not None and self.snapshot.known.error < self.mission.settled

    @property
    def left(self) -> float:
        """How much of it is to come [s]."""
        return math.inf if self.duration is None else self.duration - self.elapsed

    def see(self, snapshot: Snapshot) -> None:
        """Take a snapshot of the monitor's."""
        self.snapshot = snapshot
        self.events.extend(snapshot.events)
        if math.isfinite(snapshot.known.error):
            self.errors.append(snapshot.known.error)

    def lose_sight(self) -> None:
        """Nobody measures any more: nothing is known now, and what was is not shown as if it were."""
        self.snapshot = Snapshot(math.nan, {})
