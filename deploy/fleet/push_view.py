"""Progress of a push: bars in a terminal, a line for each event elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from types import TracebackType
from typing import Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn


class View:
    """Shows the progress of a push, here nothing; called from many threads; a context manager."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def phase(self, robot: str, phase: str) -> None:
        """Show a robot's phase: `connecting`, `comparing` or `installing`."""

    def sending(self, robot: str, files: int, total: int) -> None:
        """Show how many files and bytes are to be sent [bytes]."""

    def sent(self, robot: str, count: int) -> None:
        """Add to the bytes sent [bytes]."""

    def line(self, robot: str, text: str) -> None:
        """Show a line of the installation."""

    def end(self, robot: str, text: str, *, well: bool) -> None:
        """Show that a robot is done."""


class Plain(View):
    """A line for each event."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lock = threading.Lock()

    def phase(self, robot: str, phase: str) -> None:
        """As `View`."""
        if phase == "installing":
            self._say(robot, phase)

    def sending(self, robot: str, files: int, total: int) -> None:
        """As `View`."""
        self._say(robot, f"sending {files} files, {size(total)}")

    def end(self, robot: str, text: str, *, well: bool) -> None:  # noqa: ARG002 - as `View`
        """As `View`."""
        self._say(robot, text)

    def _say(self, robot: str, text: str) -> None:
        with self._lock:
            print(f"{robot}: {text}", file=self._stream, flush=True)


class Bars(View):
    """A bar for each robot, in a terminal. It is removed at the end: the result is in words."""

    def __init__(self, stream: TextIO, robots: Iterable[str]) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TimeElapsedColumn(),
            TextColumn("{task.fields[phase]}", style="dim"),
            console=Console(file=stream, highlight=False),
            transient=True,
        )
        self._tasks: dict[str, TaskID] = {
            robot: self._progress.add_task(robot, total=None, phase="waiting") for robot in robots
        }

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def phase(self, robot: str, phase: str) -> None:
        """As `View`."""
        self._progress.update(self._tasks[robot], phase=phase)

    def sending(self, robot: str, files: int, total: int) -> None:
        """As `View`."""
        self._progress.update(self._tasks[robot], total=total, phase=f"sending {files} files, {size(total)}")

    def sent(self, robot: str, count: int) -> None:
        """As `View`."""
        self._progress.advance(self._tasks[robot], count)

    def line(self, robot: str, text: str) -> None:
        """As `View`."""
        if text.strip():
            shown = text.strip()[:40].replace("[", r"\[")  # else rich would take it for a style
            self._progress.update(self._tasks[robot], phase=shown)

    def end(self, robot: str, text: str, *, well: bool) -> None:
        """As `View`."""
        task = self._tasks[robot]
        self._progress.update(task, total=1, completed=1 if well else 0, phase=text[:40])
        self._progress.stop_task(task)


def view_for(stream: TextIO, robots: Iterable[str]) -> View:
    """Return bars in a terminal, plain lines elsewhere."""
    return Bars(stream, robots) if stream.isatty() else Plain(stream)


def size(count: float) -> str:
    """Return a number of bytes for people: 724 B, 12 kB, 3.4 MB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= 0.9995 * scale:
            value = count / scale
            return f"{value:.0f} {unit}" if value >= 9.95 else f"{value:.1f} {unit}"
    return f"{count:.0f} B"
