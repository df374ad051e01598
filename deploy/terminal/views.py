"""Views of a run or a fleet: a table that changes in place in a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import time
from itertools import takewhile
from typing import Self, TextIO

from rich.console import Console, RenderableType
from rich.live import Live

from formation.deploy.terminal.snapshot import Progress
from formation.deploy.terminal.table import draw, event_line
from formation.deploy.terminal.units import metres
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.words import state_counts

LINE_PERIOD = 2.0
"""Time between two lines [s]."""


class Redrawn:
    """A picture that changes in place, on a terminal. A context manager: the last picture stays."""

    def __init__(self, stream: TextIO) -> None:
        self.console = Console(file=stream, highlight=False)
        self._live = Live(console=self.console, auto_refresh=False, transient=False)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    @property
    def ascii_only(self) -> bool:
        """Whether the terminal shows only ASCII."""
        return not (self.console.encoding or "").lower().startswith("utf")

    def redraw(self, picture: RenderableType) -> None:
        """Show `picture` in place of the last one."""
        self._live.update(picture, refresh=True)


class LiveTable(Redrawn):
    """A table that changes in place, on a terminal."""

    def show(self, progress: Progress) -> None:
        """Redraw the table."""
        size = self.console.size
        self.redraw(draw(progress, size.width, size.height, ascii_only=self.ascii_only))


class Printed:
    """Plain lines where nothing can be redrawn; a context manager, as `Redrawn` is."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def say(self, text: str) -> None:
        """Print a line."""
        print(text, file=self._stream, flush=True)


class PlainLines(Printed):
    """A line every two seconds, and one for each event."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self._last = 0.0
        self._shown: set[str] = set()
        self._phase = ""
        self._note = ""
        self._event: Event | None = None

    def show(self, progress: Progress) -> None:
        """Write the news."""
        for name, how in progress.dead.items():
            if name not in self._shown:
                self._shown.add(name)
                self.say(f"{name} {how}")
        changed, self._phase = progress.phase != self._phase, progress.phase
        if changed and progress.phase == "running":
            self._last = time.monotonic()  # nothing to show yet
        elif changed:
            self.say(
                f"{progress.mission.name}: {progress.phase} {progress.processes} processes"
                if progress.phase == "starting"
                else f"{progress.phase} after {progress.elapsed:.1f} s"
            )
        if progress.phase == "running" and time.monotonic() - self._last >= LINE_PERIOD:
            self._last = time.monotonic()
            self.say(line(progress))
        if progress.snapshot is None and progress.note != self._note:
            self._note = progress.note
            self.say(f"{progress.mission.name}: {self._note}")
        self._tell_events(progress)

    def _tell_events(self, progress: Progress) -> None:
        news = takewhile(lambda event: event is not self._event, reversed(progress.events))
        for event in list(news)[::-1]:
            self.say(event_line(event))
            self._event = event


View = LiveTable | PlainLines


def view_for(stream: TextIO, *, table: bool) -> View:
    """Return a table if that is wanted and `stream` is a terminal, plain lines else."""
    return LiveTable(stream) if table and in_a_terminal(stream) else PlainLines(stream)


def in_a_terminal(stream: TextIO) -> bool:
    """Return whether text written to `stream` can be changed afterwards."""
    return stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def line(progress: Progress) -> str:
    """Return the run so far in one line."""
    of = "" if progress.duration is None else f" of {progress.duration:g}"
    head = f"{progress.elapsed:5.1f}{of} s"
    snapshot = progress.snapshot
    if snapshot is None:
        note = progress.note.partition("\n")[0]
        return f"{head}  {note or 'nothing received from the monitor yet'}"
    if not snapshot.robots:
        return f"{head}  nothing is known: the monitor has ended"
    counts = state_counts(robot.state for robot in snapshot.robots.values())
    over = f" over {snapshot.partial.words}" if snapshot.partial else ""
    settled = "  settled" if progress.settled else ""
    return f"{head}  error {metres(snapshot.known_error)}{over}{settled}  {counts}"
