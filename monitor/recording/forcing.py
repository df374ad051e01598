"""The thread that forces written data to the disk, so that writing does not wait for it.

Written data is safe from a kill, forced data from a power cut. A slow card takes seconds for the second and
almost no time for the first.
"""

from __future__ import annotations

import threading
from collections import Counter
from queue import Empty, SimpleQueue
from typing import NamedTuple

from formation.monitor.recording.part import Part


class Mark(NamedTuple):
    """Progress of a recording."""

    number: int
    """Number of chunks processed, written or lost."""
    counts: Counter[int]
    """Messages in all parts, by channel."""
    size: int
    """Size of all parts together [bytes]."""


NOTHING = Mark(0, Counter(), 0)


class Forcer:
    """Force the newest requested part to the disk."""

    def __init__(self) -> None:
        self.safe = NOTHING
        """Up to where everything is on the disk itself."""
        self._error: OSError | None = None
        self._lock = threading.Lock()
        self._queue: SimpleQueue[tuple[Part, Mark] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="forcing", daemon=True)
        self._thread.start()

    def request(self, part: Part, mark: Mark) -> None:
        """Request forcing `part`, after which `mark` is safe. Raises OSError if an earlier one failed."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        self._queue.put((part, mark))

    def confirm(self, mark: Mark) -> None:
        """Note that `mark` is safe already."""
        with self._lock:
            if mark.number >= self.safe.number:
                self.safe = mark

    def close(self) -> None:
        """End after all requests are done."""
        self._queue.put(None)

    def _work(self) -> None:
        while (requested := self._newest()) is not None:
            part, mark = requested
            try:
                part.sync()
            except OSError as error:
                self._error = error
            else:
                self.confirm(mark)

    def _newest(self) -> tuple[Part, Mark] | None:
        """Return the newest request: it includes the earlier ones, as an ended part has been forced."""
        requested = self._queue.get()
        while requested is not None:
            try:
                requested = self._queue.get_nowait()
            except Empty:
                break
        return requested
