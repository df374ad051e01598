"""Modules that a program does not load, so that it starts fast and small."""

from __future__ import annotations

import subprocess
import sys

import pytest

ON_A_ROBOT = "formation.ros2.naming, formation.transport.robot_bus"
"""Modules that a robot's processes load to open the robot's bus."""
ABSENT = [
    (f"formation.agent.__main__, {ON_A_ROBOT}", "numpy rosbags numba asyncio mcap matplotlib"),
    (f"formation.agent.watchdog.__main__, {ON_A_ROBOT}", "numpy rosbags numba asyncio mcap matplotlib"),
    ("formation.deploy.cli", "numpy pydantic zenoh rich"),
    ("formation.deploy.order", "rosbags rich mcap ssl"),
    ("formation.transport.runtime.process, formation.transport.runtime.flags", "rich mcap matplotlib pytest"),
]
"""Imported modules, and the modules that they must not load."""


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.smoke
@pytest.mark.parametrize(("imported", "absent"), ABSENT, ids=[imported for imported, _ in ABSENT])
def test_program_does_not_load_heavy_modules(imported: str, absent: str) -> None:
    done = python(f"import sys, {imported}; print(*(set({absent.split()}) & set(sys.modules)))")
    assert (done.stdout.split(), done.stderr) == ([], "")


@pytest.mark.parametrize(
    "arguments", [["check", "--json"], ["simulate", "--json"], ["doctor", "--help"]], ids="_".join
)
def test_command_runs_without_extras(arguments: list[str]) -> None:
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
