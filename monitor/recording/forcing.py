"""The thread that forces to the disk what has been written, so that writing does not wait for it.

What is written is safe from a kill, what is forced from a power cut. A slow card takes seconds for the second
and next to nothing for the first.
"""

from __future__ import annotations

import threading
from collections import Counter
from queue import Empty, SimpleQueue
from typing import NamedTuple

from monitor.recording.part import Part


class Mark(NamedTuple):
    """How far a recording has come."""

    number: int
    """Chunks that have been dealt with, in one way or the other."""
    counts: Counter[int]
    """Messages in all parts, by channel."""
    size: int
    """All parts together [bytes]."""


NOTHING = Mark(0, Counter(), 0)


class Forcer:
    """Forces the newest of what it is asked for."""

    def __init__(self) -> None:
        self.safe = NOTHING
        """So far everything is on the disk itself."""
        self._error: OSError | None = None
        self._lock = threading.Lock()
        self._queue: SimpleQueue[tuple[Part, Mark] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="forcing", daemon=True)
        self._thread.start()

    def ask(self, part: Part, mark: Mark) -> None:
        """Have `part` forced, after which `mark` is safe. Raises OSError if that has failed since."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        self._queue.put((part, mark))

    def confirm(self, mark: Mark) -> None:
        """`mark` is safe already."""
        with self._lock:
            if mark.number >= self.safe.number:
                self.safe = mark

    def close(self) -> None:
        """End, after all that was asked for."""
        self._queue.put(None)

    def _work(self) -> None:
        while (asked := self._newest()) is not None:
            part, mark = asked
            try:
                part.sync()
            except OSError as error:
                self._error = error
            else:
                self.confirm(mark)

    def _newest(self) -> tuple[Part, Mark] | None:
        """What was asked for last: it includes what came before, for an ended part has been forced."""
        asked = self._queue.get()
        while asked is not None:
            try:
                asked = self._queue.get_nowait()
            except Empty:
                break
        return asked
