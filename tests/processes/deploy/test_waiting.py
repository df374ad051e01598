"""The message on a terminal during a long wait, and keys without a terminal."""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from formation.deploy.fleet import fleet_status
from formation.deploy.terminal.bar import message_if_slow
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
    with message_if_slow("listening", after=0.1):
        while not screen.getvalue().endswith("\n") and time.monotonic() < deadline:
            time.sleep(0.01)
    assert (capsys.readouterr().out, screen.getvalue()) == ("", "formation: listening …\n")


@pytest.mark.parametrize(("terminal", "after"), [(True, PATIENCE), (False, 0.0)])
def test_short_wait_or_missing_terminal_shows_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *, terminal: bool, after: float
) -> None:
    screen = Screen(terminal=terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    with message_if_slow("listening", after):
        time.sleep(0.1)
    assert (capsys.readouterr().out, screen.getvalue()) == ("", "")


def test_keys_without_terminal_are_empty() -> None:
    with Path(os.devnull).open() as nothing, Keys(nothing) as keys:
        assert keys.wait(0.0) == []


def test_status_of_a_fleet_says_which_robots_it_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[str] = []

    @contextmanager
    def recorded(what: str) -> Iterator[None]:
        reported.append(what)
        yield

    fleet = SimpleNamespace(robots=("robot1", "robot2"))
    monkeypatch.setattr(fleet_status, "message_if_slow", recorded)
    monkeypatch.setattr(fleet_status, "words", lambda *_: ["the answers"])
    monkeypatch.setattr("formation.deploy.fleet.fleet.read", lambda *_, **__: fleet)
    monkeypatch.setattr("formation.deploy.fleet.fleet.on_all", lambda *_: {})
    assert fleet_status.main(["field"]) == 0
    assert reported == ["asking robot1, robot2"]
