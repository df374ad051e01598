"""The local launcher: start processes, read their output, and leave none behind.

Each child has its own session, so a Ctrl-C in the terminal reaches only the launcher, which then stops the
children in order. A child prints one JSON object per line on stdout; its stderr goes to a file. If the
launcher is killed, its children notice that their parent is gone, and stop.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any, NamedTuple, Self

from formation.deploy.local.plan import Part, Program

STOP_ORDER: tuple[Part, ...] = ("control", "watchdog", "body", "watch")
"""Order of stopping: agents and leader first, as the others must still receive their zero velocity."""
STOP_TIMEOUTS: Mapping[Part, float] = {"control": 5.0, "watchdog": 5.0, "body": 15.0, "watch": 10.0}
"""Time for a child to end after a request, before it is killed [s]; on an idle machine a tenth is enough.
Robots may render a picture at the end."""
COASTING_TIME = 1.0
"""How long robots run on after the agents have ended, so that they come to rest as wheels lag [s]."""
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIGNAL_REPEAT_TIME = 1.0
"""A signal within this time after the first counts as the same one: a terminal also sends it to a wrapper of
this process, which passes it on [s]."""
MAX_LINE_BYTES = 1 << 20
"""Longest line of a child [bytes]."""


class Event(NamedTuple):
    """One line of a child's output."""

    child: Child
    data: Mapping[str, Any]


class Child:
    """A started process."""

    def __init__(self, program: Program, folder: Path, events: SimpleQueue[Event | None]) -> None:
        self.name, self.part, self.robots = program.name, program.part, program.robots
        self.log = folder / f"{program.name.replace(' ', '-')}.log"
        self.ready = False
        self.end_requested = False
        self.summary: Mapping[str, Any] | None = None
        """Its last message; None if there was none."""
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                program.argv,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
            )
        self._reader = threading.Thread(target=self._read, args=(events,), daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def exit(self) -> int | None:
        """Its exit code, minus the signal that killed it, or None while it runs."""
        return self._process.poll()

    @property
    def died(self) -> bool:
        """Whether it ended without a request."""
        return self.exit is not None and not self.end_requested

    def end(self) -> None:
        """Request its end."""
        if self.exit is None:
            self.end_requested = True
            self._process.terminate()

    def kill(self) -> None:
        """Kill it and all processes that it started, and wait until it is gone."""
        if self.exit is None:
            self.end_requested = True
            with suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(5.0)

    def finish_reading(self) -> None:
        """Wait until all its output is in the queue, after its end."""
        self._reader.join(1.0)

    def last_log_lines(self) -> list[str]:
        """Return the last five lines of its stderr."""
        with self.log.open("rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - 8192))
            text = log.read().decode(errors="replace")
        return [line.rstrip() for line in text.splitlines() if line.strip()][-5:]

    def _read(self, events: SimpleQueue[Event | None]) -> None:
        stream = self._process.stdout
        assert stream is not None  # noqa: S101 - for the type checker: it was asked for above
        with stream, self.log.open("ab") as log:
            while line := stream.readline(MAX_LINE_BYTES):
                data = _event(line)
                if data is None:
                    log.write(b"on stdout: " + line)
                    log.flush()
                    continue
                self.ready = self.ready or data["event"] == "ready"
                if data["event"] == "summary":
                    self.summary = data
                events.put(Event(self, data))
        events.put(None)


class Launcher:
    """Children, their events, and the signals that end the run. A context manager.

    Inside the context, the first SIGINT, SIGTERM or SIGHUP only sets `interrupted`; a second one makes `stop`
    kill what has not ended. No child remains after the context.
    """

    def __init__(self, folder: Path) -> None:
        """`folder` takes one log file per child."""
        self.children: list[Child] = []
        self.interrupted = False
        """Whether a signal has requested the end."""
        self._forced = False
        self._first_signal = math.inf  # when it came [s, monotonic]
        self._folder = folder
        self._events: SimpleQueue[Event | None] = SimpleQueue()
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        for number in STOP_SIGNALS:
            # under nohup it must go on without its terminal
            if not (number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN):
                self._handlers[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
        finally:
            for child in self.children:
                child.kill()
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def start(self, program: Program) -> Child:
        """Start a process. Raises OSError on failure."""
        child = Child(program, self._folder, self._events)
        self.children.append(child)
        return child

    def next_event(self, timeout: float) -> Event | None:
        """Return the next event; None after `timeout` [s], or sooner when a child ended or a signal came."""
        try:
            return self._events.get(timeout=max(timeout, 0.0))
        except Empty:
            return None

    def stop(self) -> None:
        """End all children in order, each within its time, and read their remaining output."""
        for part in STOP_ORDER:
            ending = [child for child in self.children if child.part == part and child.exit is None]
            for child in ending:
                child.end()
            self._wait(STOP_TIMEOUTS[part], ending)
            for child in ending:
                child.kill()
            coasting = any(child.part == "body" and child.exit is None for child in self.children)
            if part == "control" and ending and coasting:
                self._wait(COASTING_TIME)
        for child in self.children:
            child.finish_reading()

    def _wait(self, seconds: float, children: Iterable[Child] | None = None) -> None:
        """Wait for `seconds`, for `children` to end, or for a second signal, whichever comes first."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0 and not self._forced:
            if children is not None and all(child.exit is not None for child in children):
                return
            self.next_event(min(left, 0.05))

    def _interrupt(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - as signal calls it
        now = time.monotonic()
        self._forced = self._forced or now - self._first_signal > SIGNAL_REPEAT_TIME
        self._first_signal = min(self._first_signal, now)
        self.interrupted = True
        self._events.put(None)  # a SimpleQueue may be put to in a signal handler


def _event(line: bytes) -> dict[str, Any] | None:
    """Parse a line as an event; None if it is none."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and isinstance(data.get("event"), str) else None
