"""A run as far as it has come: what there is to be shown of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from deploy.snapshot import Snapshot
from formation.mission import Mission


@dataclass(slots=True)
class Progress:
    """The run so far."""

    mission: Mission
    duration: float
    """[s]"""
    processes: int
    phase: str = "starting"
    ready: int = 0
    elapsed: float = 0.0
    """[s] since all were ready."""
    snapshot: Snapshot | None = None
    errors: list[float] = field(default_factory=list)
    """Formation error of every snapshot so far [m]."""
    dead: dict[str, str] = field(default_factory=dict)
    """Processes that ended unasked, and how."""
    dead_robots: set[str] = field(default_factory=set)
    """Robots whose agent is one of them."""

    @property
    def settled(self) -> bool:
        """Whether the formation error is under the mission's bound just now."""
        return self.snapshot is not None and self.snapshot.error < self.mission.settled

    def see(self, snapshot: Snapshot) -> None:
        """Take a snapshot of the monitor's."""
        self.snapshot = snapshot
        if math.isfinite(snapshot.error):
            self.errors.append(snapshot.error)
