"""The result of a run, in words."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from formation.deploy.local.launch import Child
from formation.deploy.local.outcome import Outcome
from formation.mission.file import load


def test_unsettled_run_with_small_error_says_so() -> None:
    summary: dict[str, Any] = {"converged": False, "formation_error": 0.013, "settled_at": None}
    watch = SimpleNamespace(name="monitor", part="watch", summary=summary, died=False, exit=0)
    words = Outcome(load("six_robots"), [cast(Child, watch)], 30.0, Path("logs")).words()
    assert "13 mm, sum over 9 edges; not settled (bound 50 mm)" in words
