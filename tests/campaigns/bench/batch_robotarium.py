"""The Robotarium simulator's side of `bench_batch`: robots that drive circles, as told at every step.

python -m tests.campaigns.bench.batch_robotarium PLAN

The plan names the checkout to import it from. The same command for ever costs least: no law, no barrier
certificate. What the simulator does at each step cannot be left out: it looks for collisions and for robots
outside its arena, and draws noise for encoders, accelerometers, gyroscopes, magnetometers and headings.
"""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns.bench.batch_side import RefusedError, Run, Taken, measured

SPEED, TURN_RATE = 0.1, 1.0
"""[m/s], [rad/s]"""


def prepare(plan: dict[str, Any]) -> Run:
    """An arena with the plan's robots, ready to be stepped."""
    sys.path.insert(0, plan["checkout"])
    from rps.robotarium import Robotarium  # its place is known only now

    if plan["step"] != Robotarium.TIME_STEP:
        raise RefusedError(f"its step is {Robotarium.TIME_STEP} s")
    robots = plan["robots"]
    places = [(x, y, 0.0) for y in np.linspace(-0.8, 0.8, 5) for x in np.linspace(-1.4, 1.4, 10)]
    try:
        arena = Robotarium(
            number_of_robots=robots,
            show_figure=False,
            sim_in_real_time=False,
            skip_initialization=True,
            initial_conditions=np.array(places[:robots]).T,
        )
    except (AssertionError, ValueError) as error:
        raise RefusedError(str(error)) from None
    everybody, command = np.arange(robots), np.tile([[SPEED], [TURN_RATE]], robots)

    def run(steps: int) -> Taken:
        began = time.perf_counter()
        for _ in range(steps):
            arena.get_poses()  # it insists on being asked
            arena.set_velocities(everybody, command)
            arena.step()
        return Taken(steps * robots, time.perf_counter() - began)

    return run


def version(checkout: Path) -> str:
    """What the checkout calls itself."""
    setup = (checkout / "setup.py").read_text(encoding="utf-8")
    found = re.search(r"^VERSION\s*=\s*'([^']+)'", setup, re.MULTILINE)
    return found[1] if found else "of unknown version"


if __name__ == "__main__":
    measured(f"Robotarium {version(Path(json.loads(sys.argv[1])['checkout']))}", prepare)
