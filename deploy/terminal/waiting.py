"""A sign of life from a command that people wait for."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

AFTER = 1.0
"""What is done sooner needs no such sign [s]."""


@contextmanager
def waiting(what: str, after: float = AFTER) -> Iterator[None]:
    """Say `what` on a terminal, once, if the block takes longer than `after` [s]; a script hears nothing."""

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
