"""What the tests of the watchdog go by: what a stall of the machine excuses, and what it does not."""

from __future__ import annotations

from pathlib import Path

import pytest

from formation.transport.wiring import Endpoints
from tests.processes.agent.watchdog_team import (
    LEADER_SPEED,
    LEFT_BEHIND,
    PERIOD,
    ROBOTS,
    left_behind,
    resumed_without_a_lurch,
    unstalled,
    write_mission,
)
from tests.processes.agent.wheels import Moving, Said, Wheels


def odometry(*speeds: float, start: float = 0.0) -> list[Moving]:
    return [Moving(start + i * PERIOD, speed, 0.0) for i, speed in enumerate(speeds)]


def commands(*speeds: float) -> list[Said]:
    return [Said(i * PERIOD, speed, 0.0) for i, speed in enumerate(speeds)]


def resumed(path: Path, result: list[Said], errors: list[float]) -> None:
    """A robot was told this, and was so far from its place one period after each [m]."""
    where = Endpoints(
        {name: f"tcp/127.0.0.1:{7000 + i}" for i, name in enumerate(("robot1", *ROBOTS))},
        {name: f"tcp/127.0.0.1:{8000 + i}" for i, name in enumerate(ROBOTS)},
    )
    wheels = Wheels(write_mission(path / "mission.toml", where), path / "notes")
    wheels.said["robot2"] = result
    wheels.errors["robot2"] = [
        (one.arrived + PERIOD, error) for one, error in zip(result, errors, strict=True)
    ]
    resumed_without_a_lurch(wheels, "robot2", result[0].arrived)


def test_stop_is_excused_only_after_odometry_gap() -> None:
    before, after = odometry(*[0.2] * 20), odometry(0.0, 0.0, 0.1, *[0.2] * 20, start=1.2)
    assert {one.speed for one in unstalled(before + after)} == {0.2}
    assert len(unstalled(before + after)) > 30
    assert unstalled(odometry(0.2, 0.2, 0.0, 0.0, 0.2)) == odometry(0.2, 0.2, 0.0, 0.0, 0.2)
    later = odometry(*[0.2] * 10, 0.0, 0.2, start=1.2)
    assert 0.0 in {one.speed for one in unstalled(before + later)}


def test_left_behind_distance_grows_per_start_and_stop() -> None:
    assert left_behind(commands(0.1, 0.2, 0.2)) == pytest.approx(LEFT_BEHIND)
    held = left_behind(commands(0.1, 0.2, 0.0, 0.0, 0.0, 0.1, 0.2))
    assert held == pytest.approx(2.0 * LEFT_BEHIND + 3.0 * PERIOD * LEADER_SPEED)


def test_restopped_robot_may_lag_but_not_go_astray(tmp_path: Path) -> None:
    behind, stood = [0.3, 0.3, 0.31, 0.32, 0.33, 0.335, 0.33], commands(0.1, 0.2, 0.0, 0.0, 0.0, 0.1, 0.2)
    resumed(tmp_path, stood, behind)
    with pytest.raises(AssertionError, match="astray"):
        resumed(tmp_path, commands(0.1, *[0.2] * 6), behind)
    with pytest.raises(AssertionError, match="astray"):
        resumed(tmp_path, stood, [*behind[:-1], 0.37])
