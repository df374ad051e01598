"""A question to everybody who answers a key, and the answers to it as they come in."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple


class Reply(NamedTuple):
    """One answer."""

    key: str
    payload: bytes
    ms: float
    """Round trip [ms]."""


class Question:
    """A question that was put, and the answers to it as they come in."""

    def __init__(self) -> None:
        self.replies: list[Reply] = []
        """Those that have come so far."""
        self._start = time.perf_counter()
        self._done = threading.Event()

    @property
    def over(self) -> bool:
        """Whether no more will come: all have answered, or its time is over, or nobody is there."""
        return self._done.is_set()

    def wait(self, patience: float) -> bool:
        """Wait until it is `over`, at most so long [s]; whether it is."""
        return self._done.wait(patience)

    def take(self, key: str, payload: bytes) -> None:
        """An answer has come."""
        self.replies.append(Reply(key, payload, (time.perf_counter() - self._start) * 1e3))

    def end(self) -> None:
        """No more will come."""
        self._done.set()
