"""Notice that this machine stood still: a virtual machine may be paused, a host have too much to do."""

from __future__ import annotations

import threading
from time import monotonic, sleep  # as they are, though a test replaces those of `time`

MIN_STALL_SECONDS = 0.1
"""A thread that asks for a short sleep is late by this much only if the machine had no time for it."""
SLEEP_SECONDS = 0.01


class StallWatch:
    """Record the longest delay of a thread that has nothing to do but to wake."""

    def __init__(self) -> None:
        self._longest = 0.0
        self._thread = threading.Thread(target=self._watch, name="stalls", daemon=True)

    def start(self) -> None:
        """Watch until the process ends."""
        self._thread.start()

    def longest_since_last_call(self) -> float:
        """Return the longest delay since the last call [s], and forget it."""
        longest, self._longest = self._longest, 0.0
        return longest

    def _watch(self) -> None:
        before = monotonic()
        while True:
            sleep(SLEEP_SECONDS)
            now = monotonic()
            self._longest = max(self._longest, now - before - SLEEP_SECONDS)
            before = now
