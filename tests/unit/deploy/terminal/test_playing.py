"""Display of a replay in a terminal, and its keys."""

from __future__ import annotations

import io
import itertools
import os
import pty
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TextIO

import pytest
from rich.console import Console

from formation.deploy.terminal.playing import Keys, ReplayLines, clock, do_key, draw, keys_in, line
from formation.mission.file import load
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.replay.player import Player
from formation.monitor.replay.process import Replay, ReplayState
from formation.wire import Now
from tests.unit.monitor.replay.test_player import START, reel

SIX = load("six_robots")
SEEN = Metrics(SIX).snapshot(Now(0.0, 0.0))
STATE = ReplayState(
    1012.34, 1000.0, 1100.0, 2.0, paused=False, seeking=False, finished=False, counted_from=1000.0,
    drift=0.0, played=7, published=7, skipped=0, seeks=0,
)  # fmt: skip


def picture(state: ReplayState, width: int = 80, *, ascii_only: bool = False) -> list[str]:
    console = Console(width=width, file=io.StringIO(), color_system=None, force_terminal=True)
    console.print(draw(state, SEEN, width, ascii_only=ascii_only))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


@pytest.mark.parametrize("width", [40, 80, 200])
def test_two_lines_show_position_speed_and_robots(width: int) -> None:
    first, second = picture(STATE, width)
    assert first.startswith("▶ 0:12.3 ━")
    assert max(len(first), len(second)) < width
    if width >= 80:
        assert "╌ 1:40.0  2x  error       -  6 unseen" in first
        assert second == "space pause/play   ←/→ 5 s   +/- speed   q quit"


def test_pause_seek_and_end_have_their_own_signs() -> None:
    assert picture(replace(STATE, paused=True))[0].startswith("⏸")
    assert picture(replace(STATE, finished=True))[0].startswith("⏸")
    assert picture(replace(STATE, seeking=True))[0].startswith("»")
    assert "╌" not in picture(replace(STATE, position=1000.0, end=1000.0))[0], "no time remains"
    assert all(text.isascii() for text in picture(STATE, ascii_only=True))


def test_second_line_reports_counting_start_lateness_and_skipped_messages() -> None:
    second = picture(replace(STATE, counted_from=1005.0, drift=1.25, skipped=3), 200)[1]
    assert "settling and counts since 0:05.0" in second
    assert "1.2 s late" in second
    assert "3 messages came too late to be published" in second


def test_log_lines_come_every_two_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count(1000)
    monkeypatch.setattr("formation.deploy.terminal.playing.time.monotonic", lambda: 0.1 * next(ticks))
    stream = io.StringIO()
    view = ReplayLines(stream)
    for _ in range(50):
        view.show(STATE, lambda: SEEN)
    assert stream.getvalue().splitlines() == ["0:12.3 of 1:40.0  2x  error -  6 unseen"] * 3
    assert line(replace(STATE, paused=True), SEEN).startswith("0:12.3 of 1:40.0  2x paused")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0:00.0"), (59.96, "1:00.0"), (65.3, "1:05.3"), (3599.99, "1:00:00.0"), (3723.4, "1:02:03.4")],
)
def test_clock_formats_seconds(seconds: float, text: str) -> None:
    assert clock(seconds) == text


def test_space_pauses_and_arrows_seek() -> None:
    replay = Replay(SIX, Player(reel(), 0.0))
    for key, position, paused in (
        ("space", START, True), ("right", START + 5.0, True), ("left", START, True), ("left", START, True),
        ("space", START, False), ("x", START, False),
    ):  # fmt: skip
        assert do_key(replay, key)
        assert (replay.state.position, replay.state.paused) == (position, paused)
    assert not do_key(replay, "q")


def test_speed_keys_change_speed_in_steps_within_limits() -> None:
    replay = Replay(SIX, Player(reel(), 0.0, speed=3.0))
    for presses, speed in (("+", 5.0), ("+" * 20, 100.0), ("-" * 20, 0.1)):
        for key in presses:
            do_key(replay, key)
        assert replay.state.speed == speed


def test_named_gives_names_of_keys() -> None:
    assert keys_in(b" +\x1b[C\x1b[Dq") == ["space", "+", "right", "left", "q"]
    assert keys_in(b"\x1bOC\x1b\xc3") == ["right", "escape", "\xc3"]
    assert keys_in(b"") == []


@contextmanager
def terminal() -> Iterator[tuple[int, TextIO]]:
    """The two ends of a pseudo-terminal: descriptor for typed keys, and stream that the program reads."""
    outer, inner = pty.openpty()
    with os.fdopen(inner) as stream:
        try:
            yield outer, stream
        finally:
            os.close(outer)


def test_keys_arrive_when_pressed_and_terminal_is_restored() -> None:
    with terminal() as (typing, stream):
        before = termios.tcgetattr(stream)
        with Keys(stream) as keys:
            assert not termios.tcgetattr(stream)[3] & (termios.ECHO | termios.ICANON)
            assert keys.wait(0.0) == []
            os.write(typing, b" q")
            assert keys.wait(10.0) == ["space", "q"]
        assert termios.tcgetattr(stream) == before
