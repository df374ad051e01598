"""Modules of other projects, in the working folder or on PYTHONPATH, do not replace the program's own."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.support.launched import result_of, started

pytestmark = pytest.mark.processes
WRONG = "raise ImportError('a module of another project was imported')\n"


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with another project's agent.py, leader.py, deploy.py and monitor/, also on PYTHONPATH."""
    for name in ("agent", "leader", "deploy"):
        (tmp_path / f"{name}.py").write_text(WRONG)
    (tmp_path / "monitor").mkdir()
    (tmp_path / "monitor" / "__init__.py").write_text(WRONG)
    before = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{before}" if before else str(tmp_path))
    return tmp_path


def test_fleet_runs_beside_foreign_modules(workspace: Path) -> None:
    with started(
        "turtlebot3_pair", "--watchdogs", "--duration", "4", "--no-page", folder=workspace
    ) as process:
        result = result_of(process)
    assert result["robots"] == 3
    assert result["lost"] == 0
