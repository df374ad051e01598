"""What one control step of the mathematics costs on a robot: observer, neighbours, law.

python -m tests.campaigns.bench.bench_law [--rounds N] [--json]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from formation.control.controller import Gains, Limits, Measured
from formation.control.laws import LAWS
from formation.control.observer import Travel, innovation, mended
from formation.control.plane import rotation
from formation.control.tracker import Track, carried_to, seen
from tests.campaigns.figures import command, markdown, over_rounds, span

GAINS = Gains(2.0, 1.0)


def parts() -> dict[str, Callable[[], object]]:
    """The parts of a control step, each with its inputs at hand."""
    facing, integral, point = rotation(0.7), 0.3 - 0.1j, 1.2 + 0.4j
    travel = Travel(0.01, 0.025, 0.01 * facing)
    track, limits = Track(0.0, 1.1 + 0.4j, 0.2 + 0.1j), Limits(0.1, 0.2, 1.0)
    measured = Measured(0.8 - 0.5j, 0.7 - 0.4j, 2.0, 0.2 + 0.1j)
    return {
        "observer, field": lambda: innovation(facing, travel, 5.0),
        "observer, paper": lambda: mended(facing, travel, 5.0),
        "one neighbour": lambda: carried_to(seen(track, 0.05, point, 0.1, 1.5), 0.06, 0.15),
        "law, field": lambda: LAWS["field"].step(integral, facing, measured, GAINS, limits, 0.05),
        "law, paper": lambda: LAWS["paper"].step(integral, facing, measured, GAINS, limits, 0.05),
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


def measure(rounds: int) -> Any:
    """Every part [µs], by rounds."""
    return over_rounds([{name: microseconds(call) for name, call in parts().items()} for _ in range(rounds)])


def section(found: Any) -> str:
    """The figures in Markdown."""
    return markdown(["part", "µs"], [[name, span(found[name], 2)] for name in parts()])


if __name__ == "__main__":
    command(__doc__, measure, section)
