"""How fast the batch simulation is: control steps of one robot per second of wall time.

python -m tests.bench.bench_simulate [--rounds N]

Every follower measures the two before it. The formation error of all runs is judged at every step.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from formation.ensemble import Options
from formation.mission import Mission
from formation.simulate import simulate
from tests.bench.figures import markdown, over_rounds, span
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    began = time.perf_counter()
    missions = {robots: block(robots) for robots, _ in CASES}
    built = time.perf_counter() - began
    rounds = [
        {
            f"{robots} {runs}": {
                name: rate(missions[robots], runs, law, options) for name, (law, options) in VARIANTS.items()
            }
            for robots, runs in CASES
        }
        for _ in range(arguments.rounds)
    ]
    found = over_rounds(rounds)
    rows = [
        [f"{robots:,} × {runs}", *(span(found[f"{robots} {runs}"][name], 2) for name in VARIANTS)]
        for robots, runs in CASES
    ]
    print(markdown(["million robot steps a second", *VARIANTS], rows))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"Missions read in {built:.2f} s; peak memory of the whole {peak:.0f} MiB.")


if __name__ == "__main__":
    main()
