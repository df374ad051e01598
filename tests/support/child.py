"""A process under test: started, listened to, ended, and never left behind."""

from __future__ import annotations

import json
import os
import queue
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import cycle
from typing import Any

PATIENCE = 30.0
"""How long a test waits for what takes a fraction of a second on an idle machine [s]."""
_PORTS = cycle(random.SystemRandom().sample(range(20_000, 32_000), 12_000))
"""None is given twice, so that what is asked for together differs, though no process listens there yet.

They are below the ports that systems give on request, and each run has an order of its own.
"""


class Child:
    """``python -m MODULE ARGUMENTS``, and every line that it says."""

    def __init__(self, module: str, *arguments: str, nice: int = 0) -> None:
        self.process = subprocess.Popen(
            [*niced(nice), sys.executable, "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._errors: list[str] = []
        self._readers = [
            threading.Thread(target=read, daemon=True) for read in (self._read, self._read_errors)
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        return self.process.pid

    def event(self, name: str, patience: float = PATIENCE) -> dict[str, Any]:
        """The next line it says, which must be this event."""
        line = self._lines.get(timeout=patience)
        assert line is not None, f"ended without saying {name!r}: {self.errors}"
        result: dict[str, Any] = json.loads(line)
        assert result["event"] == name
        return result

    def signal(self, number: int) -> float:
        """Send a signal; how long the process then took to end [s]."""
        sent = time.monotonic()
        os.kill(self.process.pid, number)
        self.process.wait(PATIENCE)
        return time.monotonic() - sent

    def wait(self) -> int:
        """Its exit code."""
        return self.process.wait(PATIENCE)

    @property
    def log(self) -> str:
        """What it wrote to stderr so far."""
        return "".join(self._errors)

    @property
    def errors(self) -> str:
        """All that it wrote to stderr; it has ended."""
        self._readers[1].join(PATIENCE)
        return "".join(self._errors)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)
        self._lines.put(None)

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self._errors.append(line)


def until(condition: Callable[[], object]) -> float:
    """Wait for what must come; how long it took [s]."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() < start + PATIENCE
        time.sleep(0.001)
    return time.monotonic() - start


def niced(nice: int) -> tuple[str, ...]:
    """What starts a process with a priority of its own, as units do; that takes root to raise one."""
    return ("nice", "-n", str(nice)) if nice and os.geteuid() == 0 else ()


@contextmanager
def started(module: str, *arguments: str, nice: int = 0) -> Iterator[Child]:
    """A child that is killed at the end, if it still lives."""
    child = Child(module, *arguments, nice=nice)
    with child.process:  # which waits for it and closes its streams
        try:
            yield child
        finally:
            child.process.kill()
            for reader in child._readers:
                reader.join(PATIENCE)


def free_endpoint() -> str:
    """An endpoint of this machine on which no process listens, given once."""
    while True:
        port = next(_PORTS)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return f"tcp/127.0.0.1:{port}"


@contextmanager
def held_endpoint() -> Iterator[str]:
    """An endpoint that is given once while it is held, though Zenoh may listen on it.

    For what listens only after a while. On Linux a port may be listened on beside a socket that is merely
    bound to it, if both allow the reuse of addresses.
    """
    while True:
        port = next(_PORTS)
        with socket.socket() as holder:
            holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                holder.bind(("127.0.0.1", port))
            except OSError:
                continue
            yield f"tcp/127.0.0.1:{port}"
            return
