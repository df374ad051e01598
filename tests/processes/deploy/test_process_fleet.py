"""The fixture `process_fleet`: a fleet of real processes for users' tests."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import pytest

from formation.deploy.testing.processes import ProcessFleet
from formation.deploy.testing.pytest_plugin import MakeProcesses
from tests.support.child import PATIENCE

pytestmark = pytest.mark.processes
PAIR = "turtlebot3_pair"


def test_pair_obeys_orders_and_survives_faults(process_fleet: MakeProcesses, tmp_path: Path) -> None:
    """One of its robots is played by a driver, as a user's own may be."""
    driver = [
        sys.executable,
        "-m",
        "formation.agent.simulated",
        PAIR,
        "--robot",
        "robot2",
        "-l",
        "{endpoint}",
    ]
    fleet = process_fleet(PAIR, drivers={"robot2": driver}, folder=tmp_path / "here")
    fleet.run_until_settled()
    assert any("driver robot2" in file.name.replace("-", " ") for file in (tmp_path / "here").iterdir())

    assert fleet.order("rotate", degrees=30.0).obeyed
    fleet.run_until_settled()
    fleet.kill("robot2")
    outcome = fleet.order("hold")
    assert outcome.missing == ["robot2"]
    fleet.start("robot2")
    assert fleet.order("run").obeyed
    fleet.run_until_settled()

    fleet.cut(["robot2"], ["leader", "robot1"])
    wait_for_state(fleet, "robot2", "hold")
    fleet.heal()
    wait_for_state(fleet, "robot2", "run")
    fleet.freeze("robot2")
    fleet.run(1.0)
    fleet.thaw("robot2")
    fleet.run_until_settled()

    drive_by_keys(fleet)
    wait_for_state(fleet, "robot2", "hold")

    fleet._child("robot2")._process.kill()  # without the fleet's knowledge
    with pytest.raises(AssertionError, match=r"agent robot2 ended, exit code -9"):
        fleet.run(10.0)
    fleet.close()
    assert fleet.recording.stat().st_size > 0


def drive_by_keys(fleet: ProcessFleet) -> None:
    """Drive with `formation drive` at a terminal, and kill it while it drives."""
    terminal, keyboard = pty.openpty()
    command = (sys.executable, "-m", "formation.deploy", "drive", PAIR, "-e", fleet._agents["leader"])
    with subprocess.Popen(command, stdin=keyboard) as driver:
        deadline = time.monotonic() + PATIENCE
        while not any("run" in one.text and "driven" in one.text for one in fleet.events):
            assert time.monotonic() < deadline, "the keys did not drive"
            os.write(terminal, b"i")
            fleet.run(0.05)
        driver.kill()
    os.close(terminal)
    os.close(keyboard)


def test_illegal_fault_is_refused_before_processes_start(process_fleet: MakeProcesses) -> None:
    for fault in ("robot9:frozen@3", "robot2:melt@3"):
        with pytest.raises(ValueError, match=r"(robot9'|melt): must be one of"):
            process_fleet("turtlebot3_pair", faults=[fault])


def test_driver_of_unknown_robot_is_refused(process_fleet: MakeProcesses) -> None:
    with pytest.raises(ValueError, match="drivers: robot9: must be one of robot1, robot2"):
        process_fleet(PAIR, drivers={"robot9": ["true"]})


def wait_for_state(fleet: ProcessFleet, robot: str, state: str) -> None:
    for _ in range(600):
        if fleet.state(robot) == state:
            return
        fleet.run(0.1)
    raise AssertionError(f"{robot} is not in {state}: {fleet.state(robot)}, error {fleet.error():.3f}")
