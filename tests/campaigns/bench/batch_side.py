"""One side of `bench_batch` in a process of its own: how fast it steps robots, and the memory that it takes.

This module imports nothing but the standard library: a peer's Python has nothing of this project.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

FEWEST = 2
"""Steps of the first, untimed run."""


class Taken(NamedTuple):
    """What a run came to."""

    robot_steps: int
    """Control steps of all robots."""
    seconds: float
    """Wall time of them, without what was made ready before."""


Run = Callable[[int], Taken]
"""Takes all robots so many steps further."""


class RefusedError(Exception):
    """This side does not take so many robots; the message is in its own words."""


def measured(name: str, prepare: Callable[[dict[str, Any]], Run]) -> None:
    """Print as JSON how fast the robots of the plan on the command line are stepped.

    The plan, which `prepare` takes, has at least `robots`, `step` [s] and either `seconds` to measure for or
    the number of `steps`.
    """
    plan = json.loads(sys.argv[1])
    began = time.perf_counter()
    try:
        run = prepare(plan)
    except RefusedError as refusal:
        found: dict[str, Any] = {"refused": str(refusal)}
    else:
        ready = time.perf_counter()
        run(FEWEST)
        first = time.perf_counter()
        steps, taken = (plan["steps"], run(plan["steps"])) if "steps" in plan else timed(run, plan["seconds"])
        found = {
            "robot_steps_per_s": taken.robot_steps / taken.seconds,
            "steps": float(steps),
            "ready_s": ready - began,
            "first_s": first - ready,
            "peak_mib": peak_mib(),
        }
    print(json.dumps({"name": name, **found}))


def timed(run: Run, seconds: float) -> tuple[int, Taken]:
    """A run that takes about `seconds` or longer: its steps, and what it came to."""
    steps = FEWEST
    while (taken := run(steps)).seconds < 0.8 * seconds:
        steps = math.ceil(steps * min(50.0, seconds / taken.seconds))
    return steps, taken


def peak_mib() -> float:
    """The most memory that this process has had resident [MiB]."""
    # getrusage would count what the parent had before this program was executed
    status = Path("/proc/self/status").read_text(encoding="ascii")
    kibibytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(kibibytes) / 1024.0
