"""A message from a command that takes long."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

MESSAGE_DELAY = 1.0
"""Time from which on the message is shown [s]."""


@contextmanager
def waiting(what: str, after: float = MESSAGE_DELAY) -> Iterator[None]:
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
