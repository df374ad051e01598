"""An agent is small and starts at once because of what it does not load."""

from __future__ import annotations

import subprocess
import sys

import pytest

ON_A_ROBOT = ("agent.__main__", "formation.ros2.naming", "formation.transport.robot_bus")
"""What runs on a robot, with what it loads only when it opens its robot's bus."""
HEAVY = ("numpy", "rosbags", "numba", "asyncio", "mcap", "matplotlib")


@pytest.mark.parametrize("processes", [ON_A_ROBOT, ("agent.robots.guard.__main__", *ON_A_ROBOT[1:])])
def test_what_runs_on_a_robot_loads_no_arrays_and_nothing_of_a_desk(processes: tuple[str, ...]) -> None:
    asked = f"import sys, {', '.join(processes)}; print(*(name for name in {HEAVY} if name in sys.modules))"
    found = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert not found.stdout.split()
