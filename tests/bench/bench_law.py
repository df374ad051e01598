"""What one control step of the mathematics costs: observer, neighbours, law; one robot, or an array of them.

python -m tests.bench.bench_law [--rounds N] [--json]

The scalar line is what an agent computes for each odometry message; the array lines are what the simulation
computes at each step, per robot.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from formation.heading import Travel, innovation, printed
from formation.law import LAWS, Gains, Limits, Measured
from formation.neighbour import Track, carried_to, seen
from formation.plane import unit
from tests.bench.figures import flags, markdown, over_rounds, show, span

GAINS = Gains(2.0, 1.0)
SIZES = (1, 6, 100, 10_000)
"""Robots at once; 1 is a scalar, not an array of one."""


def parts(robots: int, rng: np.random.Generator) -> dict[str, Callable[[], object]]:
    """The parts of a control step, each with its inputs at hand."""

    def vectors() -> Any:
        drawn = rng.normal(size=robots) + 1j * rng.normal(size=robots)
        return complex(drawn[0]) if robots == 1 else drawn

    facing, integral, point = unit(vectors()), vectors(), vectors()
    step = 0.05 * np.ones(robots) if robots > 1 else 0.05
    travel = Travel(0.2 * step, 0.5 * step, 0.2 * step * facing)
    track, limits = Track(0.0, vectors(), vectors()), Limits(2.0 * step, 4.0 * step, 20.0 * step)
    measured = Measured(vectors(), vectors(), 2 * step / step, vectors())
    return {
        "observer, field": lambda: innovation(facing, travel, 5.0),
        "observer, paper": lambda: printed(facing, travel, 5.0),
        "one neighbour": lambda: carried_to(seen(track, 0.05, point, 0.1, 1.5), 0.06, 0.15),
        "law, field": lambda: LAWS["field"](integral, facing, measured, GAINS, limits, 0.05),
        "law, paper": lambda: LAWS["paper"](integral, facing, measured, GAINS, limits, 0.05),
    }


def microseconds(call: Callable[[], object], seconds: float = 0.1) -> float:
    """Time of one call [µs], over about so long."""
    call()
    count, began = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - began) < seconds:
        for _ in range(10):
            call()
        count += 10
    return 1e6 * elapsed / count


def one_round(rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Every part at every size [µs per robot]."""
    return {
        str(size): {name: microseconds(call) / size for name, call in parts(size, rng).items()}
        for size in SIZES
    }


def measure(rounds: int) -> Any:
    """Every part at every size, by rounds."""
    rng = np.random.default_rng(0)
    return over_rounds([one_round(rng) for _ in range(rounds)])


def section(found: Any) -> str:
    """The figures in Markdown."""
    header = ["[µs per robot]", *("scalar" if size == 1 else f"{size:,} robots" for size in SIZES)]
    rows = [
        [name, *(span(found[str(size)][name], 3 if size > 1 else 1) for size in SIZES)]
        for name in found[str(SIZES[0])]
    ]
    return markdown(header, rows)


def main() -> None:
    """Print the figures."""
    arguments = flags(__doc__).parse_args()
    show(measure(arguments.rounds), section, as_json=arguments.json)


if __name__ == "__main__":
    main()
