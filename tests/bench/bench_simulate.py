"""How fast the batch simulation is: control steps of one robot per second of wall time.

python -m tests.bench.bench_simulate [--rounds N] [--json]

Every follower measures the two before it. The formation error of all runs is judged at every step.
"""

from __future__ import annotations

import resource
import time
from typing import Any

import numpy as np

from formation.mission import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.bench.figures import flags, markdown, over_rounds, show, span
from tests.formation import scenarios

CASES = ((6, 1), (6, 400), (100, 1), (100, 100), (10_000, 1))
"""Robots (the leader among them), runs."""
VARIANTS = {
    "field law": ("field", Options()),
    "paper law": ("paper", Options()),
    "field law, late and lossy": ("field", Options(delay=0.1, loss=0.1)),
}
WORK = 400_000
"""Robot steps of one measurement, at most."""


def block(robots: int) -> Mission:
    """Robots on a grid a metre apart, each measuring the two before it."""
    side = max(1, int(np.sqrt(robots)))
    place = np.arange(robots)
    slots = (-(place % side) - 1j * (place // side)).astype(np.complex128)
    behind = [tuple(j for j in (i - 2, i - 1) if j >= 0) for i in range(robots)]
    return scenarios.build(slots, behind, simulation={"spread": 0.4})


def rate(mission: Mission, runs: int, law: str, options: Options) -> float:
    """Robot steps per second [1e6/s]."""
    steps = int(np.clip(WORK // (runs * len(mission.followers)), 20, 1000))
    result = simulate(
        mission, runs=runs, law=law, options=options, horizon=0.02 * steps, step=0.02, starts="random"
    )
    return 1e-6 * result.robot_steps / result.wall_time


def measure(rounds: int) -> Any:
    """Robot steps per second [1e6/s] of every case and variant; what reading the missions took [s]."""
    began = time.perf_counter()
    missions = {robots: block(robots) for robots, _ in CASES}
    built = time.perf_counter() - began
    found = over_rounds(
        [
            {
                f"{robots:,} × {runs}": {
                    name: rate(missions[robots], runs, law, options)
                    for name, (law, options) in VARIANTS.items()
                }
                for robots, runs in CASES
            }
            for _ in range(rounds)
        ]
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"million_robot_steps_per_second": found, "missions_read_s": built, "peak_mib": peak}


def section(found: Any) -> str:
    """The figures in Markdown."""
    rows = [
        [case, *(span(figures[name], 2) for name in VARIANTS)]
        for case, figures in found["million_robot_steps_per_second"].items()
    ]
    table = markdown(["robots × runs, million robot steps a second", *VARIANTS], rows)
    read, peak = found["missions_read_s"], found["peak_mib"]
    return f"{table}\nMissions read in {read:.2f} s; peak memory of the whole {peak:.0f} MiB.\n"


def main() -> None:
    """Print the figures."""
    arguments = flags(__doc__).parse_args()
    show(measure(arguments.rounds), section, as_json=arguments.json)


if __name__ == "__main__":
    main()
