"""Who waits at a terminal for longer than a moment is told for what."""

from __future__ import annotations

import sys
import time

import pytest

from deploy.terminal.waiting import waiting


@pytest.mark.parametrize(
    ("terminal", "takes", "told"),
    [(True, 0.3, "formation: listening …\n"), (True, 0.0, ""), (False, 0.3, "")],
)
def test_who_waits_at_a_terminal_is_told_for_what(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    terminal: bool,
    takes: float,
    told: str,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with waiting("listening", after=0.1):
        time.sleep(takes)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", told)
