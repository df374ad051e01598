"""A recording as what can be played: from when to when it goes, and its messages from a moment on."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import dropwhile

from monitor.recording.reader import Recorded, Recording, UnreadableError

REBUILT = 50_000
"""So many messages are passed over without anybody having to wait for long: in one to three seconds."""
SHORTEST = 8.0
"""Of this much the figures of a moment are made, settling and counts aside [s]."""


class Film:
    """One recording, to be played."""

    def __init__(self, recording: Recording) -> None:
        """Raises UnreadableError for a recording without any messages."""
        extent = recording.extent()
        if extent.start is None or extent.end is None:
            raise UnreadableError(f"{recording.path}: has no messages")
        self.start = extent.start
        """Time of the first message [s, the recorder's system clock]."""
        self.end = extent.end
        """Time of the last one [s]."""
        share = min(1.0, REBUILT / max(extent.counts.total(), 1))
        self.stretch = max(SHORTEST, share * (self.end - self.start))
        """How much of it may be passed over at a time [s]."""
        self._recording = recording

    def messages(self, since: float) -> Iterator[Recorded]:
        """Every message from the first one at or after `since` [s] on, in the order of the file."""
        return dropwhile(lambda message: message.wall < since, self._recording.messages(since))
