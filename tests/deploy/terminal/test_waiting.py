"""Who waits at a terminal for longer than a moment is told for what."""

from __future__ import annotations

import io
import sys
import time

import pytest

from deploy.terminal.waiting import waiting
from tests.processes.child import PATIENCE


class Screen(io.StringIO):
    """In place of stderr: a terminal or none."""

    def __init__(self, *, terminal: bool = True) -> None:
        super().__init__()
        self._terminal = terminal

    def isatty(self) -> bool:
        return self._terminal


def test_who_waits_at_a_terminal_is_told_for_what(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    screen, deadline = Screen(), time.monotonic() + PATIENCE
    monkeypatch.setattr(sys, "stderr", screen)
    with waiting("listening", after=0.1):
        while not screen.getvalue().endswith("\n") and time.monotonic() < deadline:
            time.sleep(0.01)
    assert (capsys.readouterr().out, screen.getvalue()) == ("", "formation: listening …\n")


@pytest.mark.parametrize(("terminal", "after"), [(True, PATIENCE), (False, 0.0)])
def test_who_need_not_wait_or_has_no_terminal_is_told_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *, terminal: bool, after: float
) -> None:
    screen = Screen(terminal=terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    with waiting("listening", after):
        time.sleep(0.1)
    assert (capsys.readouterr().out, screen.getvalue()) == ("", "")
