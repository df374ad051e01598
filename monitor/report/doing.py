"""Time of each robot in each state over a recording, by its statuses and by whether it was received."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from formation.mission.model import Mission
from formation.monitor.metrics.events import LOST_SILENCE
from formation.monitor.metrics.feed import freshness_limit
from formation.monitor.metrics.snapshot import RobotMetrics

MAX_LOOK_GAP = 1.0
"""Longest time between two looks that is attributed to a state [s]."""
STATES = ("run", "hold", "stop", "waiting")
LOST_STATE, OTHER = "lost", "other"


@dataclass(slots=True)
class Doing:
    """One robot's times by activity."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Time by state [s]: one of `STATES`, ``lost`` while it was not received, ``other``."""
    unavailable: float = 0.0
    """Time in which it was unavailable, and others went on without it [s]."""
    fallback: float = 0.0
    """Time in which it measured fallback neighbours [s]."""
    avoiding: float = 0.0
    """Time in which it avoided others, or its protective zone slowed it [s]."""
    blocked: float = 0.0
    """Time in which its protective zone stopped it [s]."""
    deadlocks: int = 0
    """Number of deadlocks that it resolved."""
    times_unavailable: int = 0
    """Number of times that it became unavailable."""
    starts: int = 0
    """Number of publishers of its positions after the first."""


class Doings:
    """Times of all robots. Call `look` steadily."""

    def __init__(self, mission: Mission) -> None:
        self.each = {name: Doing() for name in mission.followers}
        self._limits = {
            name: max(LOST_SILENCE, freshness_limit(mission.robots[name].rate)) for name in mission.followers
        }
        self._unavailable = dict.fromkeys(mission.followers, False)
        self._deadlocks = dict.fromkeys(mission.followers, 0)
        self._looked = float("inf")

    def look(self, wall: float, robots: Mapping[str, RobotMetrics]) -> None:
        """Account for the states of all robots at `wall` [s]."""
        passed = wall - self._looked
        self._looked = wall
        if all(self._lost(name, robots[name]) for name in self.each):
            passed = 0.0  # before the run, or after it
        for name, doing in self.each.items():
            robot = robots[name]
            doing.starts = max(robot.publishers - 1, 0)
            doing.times_unavailable += robot.unavailable and not self._unavailable[name]
            self._unavailable[name] = robot.unavailable
            doing.deadlocks += max(0, robot.deadlocks - self._deadlocks[name])
            self._deadlocks[name] = robot.deadlocks
            if robot.age is None or not 0.0 < passed <= MAX_LOOK_GAP:
                continue
            state = self._state(name, robot)
            doing.seconds[state] = doing.seconds.get(state, 0.0) + passed
            doing.unavailable += passed * robot.unavailable
            doing.fallback += passed * bool(robot.fallback)
            doing.avoiding += passed * (robot.avoiding in {"avoids", "slowed"})
            doing.blocked += passed * (robot.avoiding == "blocked")

    def _state(self, name: str, robot: RobotMetrics) -> str:
        if self._lost(name, robot):
            return LOST_STATE
        return robot.state if robot.state in STATES else OTHER

    def _lost(self, name: str, robot: RobotMetrics) -> bool:
        return robot.age is None or robot.age > self._limits[name]
