"""Progress of a run, or of a watched fleet, for display."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from formation.deploy.terminal.snapshot import Snapshot
from formation.mission.model import Mission
from formation.monitor.metrics.events import Event

MAX_ERRORS = 7200
"""Number of values of the formation error in a picture: half an hour at four a second."""
MAX_EVENTS = 50
"""Number of newest events kept: more than a terminal has lines."""


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
        return self.snapshot is not None and self.snapshot.known.error < self.mission.settled

    @property
    def left(self) -> float:
        """Remaining time [s]."""
        return math.inf if self.duration is None else self.duration - self.elapsed

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Take a snapshot of the monitor."""
        self.snapshot = snapshot
        self.events.extend(snapshot.events)
        if math.isfinite(snapshot.known.error):
            self.errors.append(snapshot.known.error)

    def lose_sight(self) -> None:
        """Forget the current values after the monitor's end, so that old ones are not shown as current."""
        self.snapshot = Snapshot(math.nan, {})
