"""ir-sim's side of `bench_batch`: differential-drive robots that drive circles, as told at every step.

python -m tests.campaigns.bench.batch_irsim PLAN

Of what ir-sim offers this costs least: no figure, no sensor, nobody in anybody's way, and no behaviour, for
with one every robot lists all others at each step. The commands are one row for all robots from the first on,
because robots that are named are looked for.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import irsim
import numpy as np

from tests.campaigns.bench.batch_side import Run, Taken, measured

APART = 2.0
"""[m]"""
SPEED, TURN_RATE = 0.2, 0.1
"""[m/s], [rad/s]"""


def prepare(plan: dict[str, Any]) -> Run:
    """A world with the plan's robots, ready to be stepped."""
    robots, side = plan["robots"], math.ceil(math.sqrt(plan["robots"]))
    world = {
        "world": {
            "width": APART * side,
            "height": APART * side,
            "step_time": plan["step"],
            "collision_mode": "unobstructed",
        },
        "robot": [
            {
                "number": robots,
                "distribution": {"name": "manual"},
                "kinematics": {"name": "diff"},
                "shape": {"name": "circle", "radius": 0.1},
                "vel_max": [1.5, 1.5],
                "vel_min": [-1.5, -1.5],
                "state": [[APART * (i % side), APART * (i // side), 0.0] for i in range(robots)],
            }
        ],
    }
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "world.yaml"
        file.write_text(json.dumps(world), encoding="utf-8")  # which is YAML as well
        environment = irsim.make(str(file), headless=True, log_level="WARNING")

    commands = [np.array([[SPEED], [TURN_RATE]])] * robots

    def run(steps: int) -> Taken:
        last = environment.robot_list[-1]
        before, began = last.state.copy(), time.perf_counter()
        for _ in range(steps):
            environment.step(commands, action_id=0)
        seconds = time.perf_counter() - began
        if (last.state == before).all():
            raise RuntimeError("the robots stand still")
        return Taken(steps * robots, seconds)

    return run


if __name__ == "__main__":
    measured(f"ir-sim {irsim.__version__}", prepare)
