"""Unit tests start no process, open no bus and never wait for the wall clock."""

from __future__ import annotations

import subprocess
import time
from typing import Any, NoReturn

import pytest
import zenoh


@pytest.fixture(autouse=True)
def no_processes_and_no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail a test that starts a process, opens a Zenoh session or sleeps: it belongs in tests/processes."""

    def refuse(*_: Any, **__: Any) -> NoReturn:
        pytest.fail(
            "a unit test must not start a process, open a session or sleep: move it to tests/processes"
        )

    monkeypatch.setattr(subprocess.Popen, "__init__", refuse)
    monkeypatch.setattr(zenoh, "open", refuse)
    monkeypatch.setattr(time, "sleep", refuse)


@pytest.fixture
def paper_law_not_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have analyses find no settling time of the paper's law: compiling it takes over ten seconds."""
    from formation.stability import analysis

    simulated = analysis.settling_time
    monkeypatch.setattr(
        analysis, "settling_time", lambda of: None if of.law.kind == "paper" else simulated(of)
    )
