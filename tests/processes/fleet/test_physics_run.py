"""`formation run --world mujoco` for real: the same processes, but for the one in which the robots are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from formation.mission.file import load
from tests.support.launched import formed, started, wait_until_running

pytestmark = [pytest.mark.processes, pytest.mark.physics]


def test_the_papers_turtlebots_converge_when_they_have_mass(tmp_path: Path) -> None:
    flags = ("--world", "mujoco", "--duration", "90", "--record", "run.mcap")
    with started("turtlebot3_pair", *flags, folder=tmp_path) as process:
        result = formed(process, 0.05, within=15.0)
    assert set(result["processes"]) == {"monitor", "robots", "leader", "agent robot1", "agent robot2"}
    assert {name: one["exit"] for name, one in result["processes"].items() if one["exit"] != 0} == {}
    assert process.returncode == 0
    assert result["converged"]
    assert result["formation_error"] < 0.05


def run(folder: Path, *flags: str) -> tuple[dict[str, list[str]], dict[str, Any]]:
    """What the agents of six robots were started with, but for pids and ports, and how they fared."""
    output: dict[str, list[str]] = {}
    folder.mkdir()
    with started("six_robots", "--duration", "90", *flags, folder=folder) as process:
        for child in wait_until_running(process, 3.0):
            words = child.cmdline()
            if "formation.agent" in words:
                robot = words[words.index("--robot") + 1]
                output[robot] = [re.sub(r":\d+$", ":PORT", w).replace(str(process.pid), "PID") for w in words]
        result = formed(process, 0.05, within=15.0)
    assert process.returncode == 0
    return output, result


def test_the_same_agents_drive_robots_with_mass_and_robots_without(tmp_path: Path) -> None:
    kinematic, without_mass = run(tmp_path / "kinematic")
    physics, with_mass = run(tmp_path / "physics", "--world", "mujoco")
    assert set(kinematic) == set(load("six_robots").followers)
    assert physics == kinematic
    for result in (without_mass, with_mass):
        assert result["converged"]
        assert result["formation_error"] < 0.05
