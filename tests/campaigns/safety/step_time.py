"""What the collision filter costs an agent: CPU time of one step with four neighbours nearby."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from formation.agent.core import Agent
from formation.control.avoidance import Avoidance, AvoidanceParameters, Obstacle, avoid, brake
from formation.control.controller import Limits
from formation.control.pipeline import ControlState, Outcome
from formation.control.plane import rotation
from formation.control.unicycle import Command
from formation.mission.file import load
from tests.campaigns.figures import over_rounds
from tests.support.fleet import Fleet
from tests.unit.formation import scenarios

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
    limits, parameters = Limits(0.2, 1.5, 1.5), AvoidanceParameters(0.1, 0.02, 0.15)
    return lambda: avoid(Command(1.0, 0.3), around, parameters, limits, 0.2 + 0j, Avoidance(), 0.05)


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
        one, params, requested = agent.avoiding, agent._params, list[Any]()
        obstacles, stepped = one.obstacles, one.stepped

        def watched(*given: Any) -> Any:
            requested[:] = given
            return obstacles(*given)

        def whole(state: ControlState, outcome: Outcome) -> None:
            around, _ = obstacles(*requested)
            done, _ = avoid(
                outcome.target, around, params.avoidance, params.limits, 0j, state.avoidance, 0.05
            )
            brake(done, around, params.avoidance)

        def noted(state: ControlState, outcome: Outcome) -> None:
            stepped(state, outcome)
            here = self._fleet.plant(name).position
            others = [self._fleet.plant(other).position for other in self._fleet.agents if other != name]
            furthest = max(abs(other - here) for other in others)
            if one.state.acting and furthest < self.furthest:
                self.furthest = furthest
                self.took = microseconds(lambda: whole(state, outcome))

        one.obstacles, one.stepped = watched, noted  # type: ignore[method-assign, assignment]
