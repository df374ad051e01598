"""The fixture `process_fleet`: a fleet of real processes for users' tests."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import pytest

from formation.deploy.testing.pytest_plugin import MakeProcesses
from tests.support.child import PATIENCE

pytestmark = pytest.mark.processes
PAIR = "turtlebot3_pair"


def test_pair_settles_obeys_orders_and_survives_agent_restart(process_fleet: MakeProcesses) -> None:
    fleet = process_fleet(PAIR)
    fleet.run_until_settled()
    assert fleet.order("rotate", degrees=30.0).obeyed
    fleet.run_until_settled()
    fleet.kill("robot2")
    outcome = fleet.order("hold")
    assert outcome.missing == ["robot2"]
    fleet.start("robot2")
    assert fleet.order("run").obeyed
    fleet.run_until_settled()
    fleet.close()
    assert fleet.recording.stat().st_size > 0


def test_robot_recovers_after_cut_and_freeze(process_fleet: MakeProcesses) -> None:
    fleet = process_fleet(PAIR)
    fleet.run_until_settled()
    fleet.cut(["robot2"], ["leader", "robot1"])
    wait_for_state(fleet, "robot2", "hold")
    fleet.heal()
    wait_for_state(fleet, "robot2", "run")
    fleet.freeze("robot2")
    fleet.run(1.0)
    fleet.thaw("robot2")
    fleet.run_until_settled()


def test_fleet_starts_given_driver_for_robot(process_fleet: MakeProcesses, tmp_path: Path) -> None:
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


def test_keyboard_drives_fleet_until_driver_is_killed(process_fleet: MakeProcesses) -> None:
    fleet = process_fleet(PAIR)
    fleet.run_until_settled()
    terminal, keyboard = pty.openpty()
    command = (sys.executable, "-m", "formation.deploy", "drive", PAIR, "-e", fleet._agents["leader"])
    with subprocess.Popen(command, stdin=keyboard) as driver:
        deadline = time.monotonic() + PATIENCE
        while not any("run" in one.text and "driven" in one.text for one in fleet.events):
            assert time.monotonic() < deadline, "the keys did not drive"
            os.write(terminal, b"i")
            fleet.run(0.05)
        driver.kill()
    wait_for_state(fleet, "robot2", "hold")
    os.close(terminal)
    os.close(keyboard)


def test_process_that_ends_fails_run(process_fleet: MakeProcesses) -> None:
    fleet = process_fleet(PAIR)
    fleet._child("robot2")._process.kill()
    with pytest.raises(AssertionError, match=r"agent robot2 ended, exit code -9"):
        fleet.run(10.0)


def test_driver_of_unknown_robot_is_refused(process_fleet: MakeProcesses) -> None:
    with pytest.raises(ValueError, match="drivers: robot9: must be one of robot1, robot2"):
        process_fleet(PAIR, drivers={"robot9": ["true"]})


def wait_for_state(fleet: object, robot: str, state: str) -> None:
    from formation.deploy.testing.processes import ProcessFleet

    assert isinstance(fleet, ProcessFleet)
    for _ in range(600):
        if fleet.state(robot) == state:
            return
        fleet.run(0.1)
    raise AssertionError(f"{robot} is not in {state}: {fleet.state(robot)}, error {fleet.error():.3f}")
