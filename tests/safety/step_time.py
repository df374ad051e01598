"""What the collision filter costs an agent: CPU time of one step with four neighbours nearby."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from agent.core import Agent
from formation.avoidance import Manners, Obstacle
from formation.detour import Avoidance, avoid
from formation.law import Limits
from formation.mission_file import load
from formation.plane import rotation
from formation.unicycle import Command
from tests.agent.fleet import Fleet
from tests.bench.figures import over_rounds
from tests.formation import scenarios

CALLS = 2000
"""Of each round."""
ALONE, WHOLE = "the filter itself", "all that an agent does for it"


def measured(rounds: int) -> Any:
    """Both [µs], over rounds."""
    return over_rounds([{ALONE: microseconds(alone()), WHOLE: in_a_fleet()} for _ in range(rounds)])


def microseconds(step: Callable[[], object]) -> float:
    """CPU time of one call [µs]."""
    began = time.process_time()
    for _ in range(CALLS):
        step()
    return 1e6 * (time.process_time() - began) / CALLS


def alone() -> Callable[[], object]:
    """One step among four that come nearer from all sides, two with right of way."""
    around = [
        Obstacle(0.45 * rotation(0.4 + 1.5 * k), 0.1, -0.3 * rotation(0.4 + 1.5 * k), first=k < 2)
        for k in range(4)
    ]
    limits, manners = Limits(0.2, 1.5, 1.5), Manners(0.1, 0.02, 0.15)
    return lambda: avoid(Command(1.0, 0.3), around, manners, limits, 0.2 + 0j, Avoidance(), 0.05)


def in_a_fleet() -> float:
    """Five robots exchange their slots: where one has to act with all four others nearest to it [µs]."""
    fleet = Fleet(scenarios.exchanged(load("six_robots")))
    busiest = Busiest(fleet)
    fleet.run(4.0)
    return busiest.took


class Busiest:
    """Times a filter that has to act whenever it has everybody nearer than any had before."""

    def __init__(self, fleet: Fleet) -> None:
        self.took = float("nan")
        """One step [µs]."""
        self.furthest = float("inf")
        """Of its four neighbours then, from centre to centre [m]."""
        self._fleet = fleet
        for name, agent in fleet.agents.items():
            self._watch(name, agent)

    def _watch(self, name: str, agent: Agent) -> None:
        one = agent._avoiding
        original = one.command

        def step(*given: Any) -> Any:
            command, safe = original(*given)
            assert safe is not None
            return safe(command)

        def watched(*given: Any) -> Any:
            done = original(*given)
            here = self._fleet.plant(name).position
            others = [self._fleet.plant(other).position for other in self._fleet.agents if other != name]
            furthest = max(abs(other - here) for other in others)
            if one.acting and furthest < self.furthest:
                self.furthest, memory = furthest, one.memory
                self.took = microseconds(lambda: step(*given))
                one.memory = memory
            return done

        one.command = watched  # type: ignore[method-assign, assignment]
