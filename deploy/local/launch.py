"""The local launcher: starts processes, hears what they say, and leaves none behind.

Each child has a session of its own, so a Ctrl-C in the terminal reaches the launcher alone, which then stops
the children in order. A child says one JSON object per line on stdout; what it writes on stderr goes to a
file. Should the launcher be killed outright, its children notice that their parent is gone, and stop.
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
from types import FrameType, TracebackType
from typing import Any, NamedTuple, Self

from deploy.local.plan import Part, Program

STOP_ORDER: tuple[Part, ...] = ("control", "guard", "body", "watch")
"""Agents and leader first: their last words are zero velocity, which the others still have to hear."""
GRACE: Mapping[Part, float] = {"control": 5.0, "guard": 5.0, "body": 15.0, "watch": 10.0}
"""How long a child has to end after it was asked to, before it is killed [s]: a tenth of it, if nobody else
needs the processors. Robots may have a picture to render at the end."""
COAST = 1.0
"""How long the robots go on after the agents have ended, so that they come to rest, wheels lag [s]."""
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
TWICE = 1.0
"""A signal this soon after the first one says the same thing twice: a terminal sends it to a wrapper of this
process as well, and the wrapper passes it on [s]."""
LONGEST_LINE = 1 << 20
"""[bytes]"""


class Event(NamedTuple):
    """One line a child said."""

    child: Child
    data: Mapping[str, Any]


class Child:
    """A process that was started."""

    def __init__(self, program: Program, folder: Path, events: SimpleQueue[Event | None]) -> None:
        self.name, self.part, self.robots = program.name, program.part, program.robots
        self.log = folder / f"{program.name.replace(' ', '-')}.log"
        self.ready = False
        self.asked_to_end = False
        self.summary: Mapping[str, Any] | None = None
        """What it says at its end; None if it did not come to that."""
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
        """Its exit code, minus the signal that killed it, or None while it lives."""
        return self._process.poll()

    @property
    def died(self) -> bool:
        """Whether it ended without having been asked to."""
        return self.exit is not None and not self.asked_to_end

    def end(self) -> None:
        """Ask it to end."""
        if self.exit is None:
            self.asked_to_end = True
            self._process.terminate()

    def kill(self) -> None:
        """End it and whatever it started, at once, and wait until it is gone."""
        if self.exit is None:
            self.asked_to_end = True
            with suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(5.0)

    def hear_out(self) -> None:
        """Wait until all it said is in the queue; it has ended."""
        self._reader.join(1.0)

    def last_words(self, lines: int = 5) -> list[str]:
        """The end of what it wrote on stderr."""
        with self.log.open("rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - 8192))
            text = log.read().decode(errors="replace")
        return [line.rstrip() for line in text.splitlines() if line.strip()][-lines:]

    def _read(self, events: SimpleQueue[Event | None]) -> None:
        stream = self._process.stdout
        assert stream is not None  # noqa: S101 - for the type checker: it was asked for above
        with stream, self.log.open("ab") as log:
            while line := stream.readline(LONGEST_LINE):
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
    """Children, the events they send, and the signals that are to end it all. A context manager.

    Inside the context, the first SIGINT, SIGTERM or SIGHUP only sets `interrupted`; a second one makes `stop`
    kill what has not ended. However the context is left, no child outlives it.
    """

    def __init__(self, folder: Path) -> None:
        """`folder` takes one log file per child."""
        self.children: list[Child] = []
        self.interrupted = False
        """Whether a signal has asked for the end."""
        self._forced = False
        self._first_signal = math.inf  # when it came [s, monotonic]
        self._folder = folder
        self._events: SimpleQueue[Event | None] = SimpleQueue()
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        for number in STOP_SIGNALS:
            # started by nohup, it is to outlive its terminal
            if not (number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN):
                self._handlers[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.stop()
        finally:
            for child in self.children:
                child.kill()
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def start(self, program: Program) -> Child:
        """Start a process. OSError if that cannot be done."""
        child = Child(program, self._folder, self._events)
        self.children.append(child)
        return child

    def next(self, timeout: float) -> Event | None:
        """The next event; None after `timeout` [s], or sooner when a child ended or a signal came."""
        try:
            return self._events.get(timeout=max(timeout, 0.0))
        except Empty:
            return None

    def stop(self) -> None:
        """End all children in order, each within its time, and hear them out."""
        for part in STOP_ORDER:
            asked = [child for child in self.children if child.part == part and child.exit is None]
            for child in asked:
                child.end()
            self._wait_for(asked, GRACE[part])
            for child in asked:
                child.kill()
            if part == "control" and asked and self._alive("body"):
                self._pause(COAST)
        for child in self.children:
            child.hear_out()

    def _alive(self, part: Part) -> bool:
        return any(child.part == part and child.exit is None for child in self.children)

    def _wait_for(self, children: Iterable[Child], seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while any(child.exit is None for child in children) and not self._forced:
            left = deadline - time.monotonic()
            if left <= 0.0:
                return
            self.next(min(left, 0.05))

    def _pause(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0 and not self._forced:
            self.next(min(left, 0.05))

    def _interrupt(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - as signal calls it
        now = time.monotonic()
        self._forced = self._forced or now - self._first_signal > TWICE
        self._first_signal = min(self._first_signal, now)
        self.interrupted = True
        self._events.put(None)  # a SimpleQueue may be put to in a signal handler


def _event(line: bytes) -> dict[str, Any] | None:
    """A line as an event, or None if it is none."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and isinstance(data.get("event"), str) else None
