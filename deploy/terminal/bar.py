"""What a command shows on a terminal while it takes long: a message, a progress bar."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Self

from formation.simulation.compiled import AVAILABLE
from formation.transport.runtime.command_line import installing

MESSAGE_DELAY = 1.0
"""Time from which on a message is shown [s]."""
PROGRESS_DELAY = 2.0
"""Time from which on progress is shown [s]."""


def warn_if_slow() -> None:
    """Warn on stderr, if numba is not installed, that simulations take long."""
    if not AVAILABLE:
        how = installing("numba")
        print(f"formation: without numba a simulation takes over 1000 times as long: {how}", file=sys.stderr)


@contextmanager
def message_if_slow(what: str, after: float = MESSAGE_DELAY) -> Iterator[None]:
    """Print `what` once on a terminal if the block takes longer than `after` [s]; nothing for a script."""

    def say() -> None:
        print(f"formation: {what} …", file=sys.stderr, flush=True)

    timer = threading.Timer(after, say)
    timer.daemon = True
    if sys.stderr.isatty():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Bar:
    """A progress bar on a terminal's stderr, for work longer than `PROGRESS_DELAY`. A context manager."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._begin = time.monotonic()
        self._wanted = sys.stderr.isatty() and find_spec("rich") is not None
        self._stack = ExitStack()
        self._progress: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def at(self, share: float) -> None:
        """Show that `share` of the work is done."""
        if not self._wanted:
            return
        if self._progress is None:
            if time.monotonic() - self._begin < PROGRESS_DELAY:
                return
            console = import_module("rich.console").Console(stderr=True)
            kind = import_module("rich.progress").Progress
            self._progress = self._stack.enter_context(kind(console=console, transient=True))
            self._progress.add_task(self._title, total=1.0)
        self._progress.update(self._progress.task_ids[0], completed=share)
