"""Each program starts fast and small because of the modules that it does not load."""

from __future__ import annotations

import subprocess
import sys

import pytest

ON_A_ROBOT = "formation.ros2.naming, formation.transport.robot_bus"
"""What a robot's processes load besides themselves when they open the robot's bus."""
ABSENT = [
    (f"formation.agent.__main__, {ON_A_ROBOT}", "numpy rosbags numba asyncio mcap matplotlib"),
    (f"formation.agent.watchdog.__main__, {ON_A_ROBOT}", "numpy rosbags numba asyncio mcap matplotlib"),
    ("formation.deploy.cli", "numpy pydantic zenoh rich"),
    ("formation.deploy.order", "rosbags rich mcap ssl"),
    ("formation.transport.runtime.process, formation.transport.runtime.flags", "rich mcap matplotlib pytest"),
]
"""What is imported, and which modules must not come with it."""


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.smoke
@pytest.mark.parametrize(("imported", "absent"), ABSENT, ids=[imported for imported, _ in ABSENT])
def test_a_program_loads_nothing_heavy(imported: str, absent: str) -> None:
    done = python(f"import sys, {imported}; print(*(set({absent.split()}) & set(sys.modules)))")
    assert (done.stdout.split(), done.stderr) == ([], "")


@pytest.mark.parametrize(
    "arguments", [["check", "--json"], ["simulate", "--json"], ["doctor", "--help"]], ids="_".join
)
def test_a_robot_needs_no_extra_for(arguments: list[str]) -> None:
    command, *flags = arguments
    code = f"""
import sys
class Absent:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in {{"cryptography", "rich", "mcap", "matplotlib"}}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Absent())
from formation.deploy.cli import main
sys.exit(main(["{command}", "turtlebot3_pair", *{flags}]))
"""
    done = python(code)
    assert done.returncode == 0, done.stderr
