"""Output of `formation replay`: two changing lines in a terminal, occasional lines elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from formation.deploy.terminal.table import states
from formation.deploy.terminal.units import metres
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.replay.player import MAX_SPEED, MIN_SPEED
from formation.monitor.replay.process import Replay, Standing

KEYS = "space pause/play   ←/→ 5 s   +/- speed   q quit"
ASCII_KEYS = "space pause/play   left/right 5 s   +/- speed   q quit"
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SEEK_STEP = 5.0
"""Jump of an arrow key [s of the recording]."""
MIN_SHOWN_DRIFT = 0.1
"""Drift from which on it is shown [s]."""
PLAIN_PERIOD = 2.0
"""Time between two plain lines [s]."""
Look = Callable[[], Snapshot]


class Bar:
    """Two lines at the bottom of a terminal."""

    def __init__(self, stream: TextIO) -> None:
        self._console = Console(file=stream, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=False)

    def start(self) -> None:
        """Start drawing."""
        self._live.start()

    def stop(self) -> None:
        """Stop drawing; the last picture stays."""
        self._live.stop()

    def show(self, standing: Standing, look: Look) -> None:
        """Draw the state; `look` gives the metrics."""
        ascii_only = not (self._console.encoding or "").lower().startswith("utf")
        picture = draw(standing, look(), self._console.size.width, ascii_only=ascii_only)
        self._live.update(picture, refresh=True)


class Lines:
    """A line every two seconds."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._due = -math.inf

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """End."""

    def show(self, standing: Standing, look: Look) -> None:
        """Write the state, at most every two seconds; `look` gives the metrics."""
        now = time.monotonic()
        if now < self._due or standing.seeking:
            return
        self._due = now + PLAIN_PERIOD
        print(line(standing, look()), file=self._stream, flush=True)


def press(replay: Replay, key: str) -> bool:
    """Do the action of a key; return whether to go on."""
    now = replay.standing
    if key == "space":
        replay.step("play" if now.paused or now.finished else "pause")
    elif key in {"left", "right"}:
        replay.step("seek", now.position + (SEEK_STEP if key == "right" else -SEEK_STEP))
    elif key in {"+", "="}:
        replay.step("speed", min((one for one in SPEEDS if one > now.speed), default=MAX_SPEED))
    elif key == "-":
        replay.step("speed", max((one for one in SPEEDS if one < now.speed), default=MIN_SPEED))
    return key not in {"q", "Q"}


def line(standing: Standing, snapshot: Snapshot) -> str:
    """Return the state in one line."""
    parts = [
        f"{clock(standing.position - standing.start)} of {clock(standing.end - standing.start)}",
        f"{standing.speed:g}x" + (" paused" if standing.paused else ""),
        f"error {_error(snapshot)}",
        states(robot.state for robot in snapshot.robots.values()),
        *remarks(standing),
    ]
    return "  ".join(parts)


def _error(snapshot: Snapshot) -> str:
    known = snapshot.known
    over = "" if known.complete or known.error is None else f" over {known.words}"
    return f"{metres(known.error)}{over}"


def draw(standing: Standing, snapshot: Snapshot, width: int, *, ascii_only: bool = False) -> RenderableType:
    """Return the state for a terminal of `width` columns, with a bar and the keys for steering."""
    sign = _sign(standing, ascii_only=ascii_only)
    head = Text(f"{sign} {clock(standing.position - standing.start)} ", style="bold")
    tail = f" {clock(standing.end - standing.start)}  {standing.speed:g}x  "
    known = snapshot.known
    over = (
        "" if known.complete or known.error is None else f" over {known.known_edges} of {known.edges} edges"
    )
    tail += f"error {metres(known.error):>7}{over}  "
    tail += states(robot.state for robot in snapshot.robots.values())
    room = max(8, min(60, width - head.cell_len - len(tail) - 1))
    length = standing.end - standing.start
    share = (standing.position - standing.start) / length if length > 0.0 else 1.0
    done = round(room * share)
    head.append(("#" if ascii_only else "━") * done, style="green not bold")
    head.append(("." if ascii_only else "╌") * (room - done), style="dim not bold")
    head.append(tail, style="not bold")
    head.truncate(width - 1)
    below = Text(ASCII_KEYS if ascii_only else KEYS, style="dim")
    for remark in remarks(standing):
        below.append(f"   {remark}", style="yellow not dim")
    below.truncate(width - 1)
    return Group(head, below)


def remarks(standing: Standing) -> list[str]:
    """Return remarks on unexpected states."""
    found = []
    if standing.counted_from > standing.start:
        found.append(f"settling and counts since {clock(standing.counted_from - standing.start)}")
    if standing.drift > MIN_SHOWN_DRIFT:
        found.append(f"{standing.drift:.1f} s late")
    if standing.skipped:
        found.append(f"{standing.skipped} messages came too late to be published")
    return found


def clock(seconds: float) -> str:
    """Return a time of a recording: ``1:05.3``, ``1:02:03.4``."""
    tenths = round(max(seconds, 0.0) * 10)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    text = f"{minutes:02d}" if hours else f"{minutes}"
    return f"{f'{hours}:' if hours else ''}{text}:{rest // 10:02d}.{rest % 10}"


def _sign(standing: Standing, *, ascii_only: bool) -> str:
    if standing.seeking:
        return "..." if ascii_only else "»"
    if standing.paused or standing.finished:
        return "||" if ascii_only else "⏸"
    return ">" if ascii_only else "▶"
