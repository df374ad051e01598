"""A query to all queryables of a key, and the answers received so far."""

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
    """A query that was sent, and the answers received so far."""

    def __init__(self) -> None:
        self.replies: list[Reply] = []
        """Answers so far."""
        self._start = time.perf_counter()
        self._done = threading.Event()

    @property
    def over(self) -> bool:
        """Whether no more answers will come: all have answered, it timed out, or there is no queryable."""
        return self._done.is_set()

    def wait(self, patience: float) -> bool:
        """Wait until it is `over`, at most this time [s]; whether it is."""
        return self._done.wait(patience)

    def add_reply(self, key: str, payload: bytes) -> None:
        """Add an answer."""
        self.replies.append(Reply(key, payload, (time.perf_counter() - self._start) * 1e3))

    def end(self) -> None:
        """End the question: no more answers will come."""
        self._done.set()
