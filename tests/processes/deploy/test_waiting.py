"""The message on a terminal during a long wait, and keys without a terminal."""

from __future__ import annotations

import io
import os
import sys
import time
from pathlib import Path

import pytest

from formation.deploy.terminal.bar import waiting
from formation.deploy.terminal.playing import Keys
from tests.support.child import PATIENCE


class Screen(io.StringIO):
    """Replaces stderr, with or without a terminal."""

    def __init__(self, *, terminal: bool = True) -> None:
        super().__init__()
        self._terminal = terminal

    def isatty(self) -> bool:
        return self._terminal


def test_terminal_shows_reason_of_long_wait(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    screen, deadline = Screen(), time.monotonic() + PATIENCE
    monkeypatch.setattr(sys, "stderr", screen)
    with waiting("listening", after=0.1):
        while not screen.getvalue().endswith("\n") and time.monotonic() < deadline:
            time.sleep(0.01)
    assert (capsys.readouterr().out, screen.getvalue()) == ("", "formation: listening …\n")


@pytest.mark.parametrize(("terminal", "after"), [(True, PATIENCE), (False, 0.0)])
def test_short_wait_or_missing_terminal_shows_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *, terminal: bool, after: float
) -> None:
    screen = Screen(terminal=terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    with waiting("listening", after):
        time.sleep(0.1)
    assert (capsys.readouterr().out, screen.getvalue()) == ("", "")


def test_keys_without_terminal_are_empty() -> None:
    with Path(os.devnull).open() as nothing, Keys(nothing) as keys:
        assert keys.wait(0.0) == []
