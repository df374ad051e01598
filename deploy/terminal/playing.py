"""`formation replay` in a terminal: two changing lines and keys; occasional lines elsewhere."""

from __future__ import annotations

import math
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable
from typing import Any, Self, TextIO

from rich.console import Group, RenderableType
from rich.text import Text

from formation.deploy.terminal.units import metres
from formation.deploy.terminal.views import Printed, Redrawn
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import state_counts
from formation.monitor.replay.player import MAX_SPEED, MIN_SPEED
from formation.monitor.replay.process import Replay, ReplayState

KEYS = "space pause/play   ←/→ 5 s   +/- speed   q quit"
ASCII_KEYS = "space pause/play   left/right 5 s   +/- speed   q quit"
KEY_NAMES = {
    b"\x1b[C": "right", b"\x1bOC": "right", b"\x1b[D": "left", b"\x1bOD": "left", b"\x1b": "escape",
    b" ": "space",
}  # fmt: skip
"""Byte sequences of terminals for keys without a character."""
MAX_KEY_BYTES = 64
"""Number of bytes read at once: far more than is typed between two looks."""
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SEEK_STEP = 5.0
"""Jump of an arrow key [s of the recording]."""
MIN_SHOWN_DRIFT = 0.1
"""Drift from which on it is shown [s]."""
PLAIN_PERIOD = 2.0
"""Time between two plain lines [s]."""
Look = Callable[[], Snapshot]


class ReplayBar(Redrawn):
    """Two lines at the bottom of a terminal."""

    def show(self, state: ReplayState, look: Look) -> None:
        """Draw the state; `look` gives the metrics."""
        self.redraw(draw(state, look(), self.console.size.width, ascii_only=self.ascii_only))


class ReplayLines(Printed):
    """A line every two seconds."""

    _due = -math.inf

    def show(self, state: ReplayState, look: Look) -> None:
        """Write the state, at most every two seconds; `look` gives the metrics."""
        now = time.monotonic()
        if now < self._due or state.seeking:
            return
        self._due = now + PLAIN_PERIOD
        self.say(line(state, look()))


class Keys:
    """Read keys from `stream` without echo; nothing if it is no terminal.

    A context manager: outside it the terminal is as it was.
    """

    def __init__(self, stream: TextIO = sys.stdin) -> None:
        self._number = stream.fileno() if stream.isatty() else None
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        if self._number is not None:
            self._before = termios.tcgetattr(self._number)
            tty.setcbreak(self._number, termios.TCSANOW)
        return self

    def __exit__(self, *_: object) -> None:
        if self._number is not None and self._before is not None:
            termios.tcsetattr(self._number, termios.TCSANOW, self._before)

    def wait(self, seconds: float) -> list[str]:
        """Return the keys pressed within that time [s], as soon as there are any."""
        if self._number is None:
            time.sleep(seconds)
            return []
        ready, _, _ = select.select([self._number], [], [], seconds)
        if not ready:
            return []
        data = os.read(self._number, MAX_KEY_BYTES)
        if not data:  # the terminal has gone
            self._number = None
        return keys_in(data)


def keys_in(data: bytes) -> list[str]:
    """Return keys by name, or by character, from a terminal's bytes."""
    keys = []
    while data:
        length = next((n for n in (3, 1) if data[:n] in KEY_NAMES), 1)
        keys.append(KEY_NAMES.get(data[:length], data[:length].decode("latin-1")))
        data = data[length:]
    return keys


def do_key(replay: Replay, key: str) -> bool:
    """Do the action of a key; return whether to go on."""
    now = replay.state
    if key == "space":
        replay.step("play" if now.paused or now.finished else "pause")
    elif key in {"left", "right"}:
        replay.step("seek", now.position + (SEEK_STEP if key == "right" else -SEEK_STEP))
    elif key in {"+", "="}:
        replay.step("speed", min((one for one in SPEEDS if one > now.speed), default=MAX_SPEED))
    elif key == "-":
        replay.step("speed", max((one for one in SPEEDS if one < now.speed), default=MIN_SPEED))
    return key not in {"q", "Q"}


def line(state: ReplayState, snapshot: Snapshot) -> str:
    """Return the state in one line."""
    known = snapshot.known
    over = "" if known.complete or known.error is None else f" over {known.words}"
    parts = [
        f"{clock(state.position - state.start)} of {clock(state.end - state.start)}",
        f"{state.speed:g}x" + (" paused" if state.paused else ""),
        f"error {metres(known.error)}{over}",
        state_counts(robot.state for robot in snapshot.robots.values()),
        *remarks(state),
    ]
    return "  ".join(parts)


def draw(state: ReplayState, snapshot: Snapshot, width: int, *, ascii_only: bool = False) -> RenderableType:
    """Return the state for a terminal of `width` columns, with a bar and the keys for steering."""
    signs = ("...", "||", ">") if ascii_only else ("»", "⏸", "▶")
    sign = signs[0] if state.seeking else signs[1] if state.paused or state.finished else signs[2]
    head = Text(f"{sign} {clock(state.position - state.start)} ", style="bold")
    tail = f" {clock(state.end - state.start)}  {state.speed:g}x  "
    known = snapshot.known
    over = (
        "" if known.complete or known.error is None else f" over {known.known_edges} of {known.edges} edges"
    )
    tail += f"error {metres(known.error):>7}{over}  "
    tail += state_counts(robot.state for robot in snapshot.robots.values())
    room = max(8, min(60, width - head.cell_len - len(tail) - 1))
    length = state.end - state.start
    share = (state.position - state.start) / length if length > 0.0 else 1.0
    done = round(room * share)
    head.append(("#" if ascii_only else "━") * done, style="green not bold")
    head.append(("." if ascii_only else "╌") * (room - done), style="dim not bold")
    head.append(tail, style="not bold")
    head.truncate(width - 1)
    below = Text(ASCII_KEYS if ascii_only else KEYS, style="dim")
    for remark in remarks(state):
        below.append(f"   {remark}", style="yellow not dim")
    below.truncate(width - 1)
    return Group(head, below)


def remarks(state: ReplayState) -> list[str]:
    """Return remarks on unexpected states."""
    found = []
    if state.counted_from > state.start:
        found.append(f"settling and counts since {clock(state.counted_from - state.start)}")
    if state.drift > MIN_SHOWN_DRIFT:
        found.append(f"{state.drift:.1f} s late")
    if state.skipped:
        found.append(f"{state.skipped} messages came too late to be published")
    return found


def clock(seconds: float) -> str:
    """Return a time of a recording: ``1:05.3``, ``1:02:03.4``."""
    tenths = round(max(seconds, 0.0) * 10)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    text = f"{minutes:02d}" if hours else f"{minutes}"
    return f"{f'{hours}:' if hours else ''}{text}:{rest // 10:02d}.{rest % 10}"
