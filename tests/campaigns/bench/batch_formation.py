"""This project's side of `bench_batch`.

python -m tests.campaigns.bench.batch_formation PLAN

The plan says whether its robots are many runs of the shipped six robots or one formation, and may name a law,
and a delay and a loss of every link. Only followers are counted: a leader merely is where its route says.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.campaigns.bench.batch_side import Run, Taken, measured
from tests.unit.formation import scenarios

FOLLOWERS = 5
"""Of the six robots."""
ABREAST = 10


def one_formation(robots: int) -> Mission:
    """Robots ten abreast, a metre apart, each measuring the two before it."""
    place = np.arange(robots)
    slots = (-(place // ABREAST) - 1j * (place % ABREAST)).astype(np.complex128)
    neighbours = [tuple(j for j in (i - 2, i - 1) if j >= 0) for i in range(robots)]
    return scenarios.build(slots, neighbours, simulation={"spread": 0.4})


def prepare(plan: dict[str, Any]) -> Run:
    """The plan's mission, ready to be simulated."""
    robots, step = plan["robots"], plan["step"]
    if plan.get("one_formation"):
        mission, runs = one_formation(robots), 1
    else:
        mission, runs = load("six_robots"), max(1, robots // FOLLOWERS)
    options = Options(delay=plan.get("delay", 0.0), loss=plan.get("loss", 0.0))
    law = plan.get("law")

    def run(steps: int) -> Taken:
        found = simulate(
            mission, runs=runs, law=law, options=options, horizon=step * steps, step=step, starts="random"
        )
        return Taken(found.robot_steps, found.wall_time)

    return run


if __name__ == "__main__":
    measured(f"formation {version('zenoh-formation')}", prepare)
