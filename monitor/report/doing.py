"""How long each robot did what over a recording, by its own words and by whether it was heard at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from formation.mission import Mission
from monitor.figures.events import LOST, READONLY
from monitor.figures.feed import freshness_limit
from monitor.figures.snapshot import RobotFigures

WIDEST = 1.0
"""Of a longer time between two looks nothing is known [s]."""
STATES = ("run", "hold", "stop", "waiting")
LOST_STATE, OTHER = "lost", "other"


@dataclass(slots=True)
class Doing:
    """One robot's time."""

    seconds: dict[str, float] = field(default_factory=dict)
    """By state: one of `STATES`, ``lost`` while it was not heard, ``other``."""
    aside: float = 0.0
    """While it did not follow, and others went on without it [s]."""
    fallback: float = 0.0
    """While it measured fallback neighbours [s]."""
    evading: float = 0.0
    """While it got out of the way, or its protective zone slowed it [s]."""
    blocked: float = 0.0
    """While its protective zone stopped it [s]."""
    deadlocks: int = 0
    """How often it was kept from moving, and went another way."""
    asides: int = 0
    """How often that began."""
    starts: int = 0
    """Processes that spoke for it after the first."""


class Doings:
    """Everybody's. Look steadily."""

    def __init__(self, mission: Mission) -> None:
        self.each = {name: Doing() for name in mission.followers}
        self._limits = {
            name: max(LOST, freshness_limit(mission.robots[name].rate)) for name in mission.followers
        }
        self._aside = dict.fromkeys(mission.followers, False)
        self._deadlocks = dict.fromkeys(mission.followers, 0)
        self._looked = float("inf")

    def look(self, wall: float, robots: Mapping[str, RobotFigures]) -> None:
        """See how everybody is at `wall` [s]."""
        passed = wall - self._looked
        self._looked = wall
        if all(self._lost(name, robots[name]) for name in self.each):
            passed = 0.0  # before the run, or after it
        for name, doing in self.each.items():
            robot = robots[name]
            doing.starts = max(robot.voices - 1, 0)
            doing.asides += robot.aside and not self._aside[name]
            self._aside[name] = robot.aside
            doing.deadlocks += max(0, robot.deadlocks - self._deadlocks[name])
            self._deadlocks[name] = robot.deadlocks
            if robot.age is None or not 0.0 < passed <= WIDEST:
                continue
            state = self._state(name, robot)
            doing.seconds[state] = doing.seconds.get(state, 0.0) + passed
            doing.aside += passed * robot.aside
            doing.fallback += passed * bool(robot.fallback)
            doing.evading += passed * (robot.evades in {"yields", "slowed"})
            doing.blocked += passed * (robot.evades == "blocked")

    def _state(self, name: str, robot: RobotFigures) -> str:
        if self._lost(name, robot):
            return LOST_STATE
        state = robot.state.removeprefix(READONLY)
        return state if state in STATES else OTHER

    def _lost(self, name: str, robot: RobotFigures) -> bool:
        return robot.age is None or robot.age > self._limits[name]
