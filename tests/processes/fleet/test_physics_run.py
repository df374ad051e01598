"""`formation run --world mujoco` with real processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.launched import formed, started

pytestmark = [pytest.mark.processes, pytest.mark.physics]


def test_turtlebot3_pair_converges_in_mujoco(tmp_path: Path) -> None:
    flags = ("--world", "mujoco", "--duration", "90", "--record", "run.mcap")
    with started("turtlebot3_pair", *flags, folder=tmp_path) as process:
        result = formed(process, 0.05, within=15.0)
    assert set(result["processes"]) == {"monitor", "robots", "leader", "agent robot1", "agent robot2"}
    assert {name: one["exit"] for name, one in result["processes"].items() if one["exit"] != 0} == {}
    assert process.returncode == 0
    assert result["converged"]
    assert result["formation_error"] < 0.05
