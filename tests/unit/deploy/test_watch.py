"""What `formation watch --once` counts as a fleet that runs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from formation.deploy.watch import all_run


@pytest.mark.parametrize(
    ("changes", "runs"),
    [({}, True), ({"state": "hold"}, False), ({"readonly": True}, False), ({"age": 2.0}, False)],
)
def test_fleet_runs_if_no_robot_stands(changes: dict[str, Any], runs: bool) -> None:
    usual = {"state": "run", "readonly": False, "age": 0.1}
    robots = {"robot1": SimpleNamespace(**usual), "robot2": SimpleNamespace(**{**usual, **changes})}
    snapshot: Any = SimpleNamespace(robots=robots)
    assert all_run(snapshot) == runs
