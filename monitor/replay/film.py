"""A recording for playing: its time span, and its messages from a moment on."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import dropwhile

from formation.monitor.recording.reader import Recorded, Recording, UnreadableError

MAX_REBUILT_MESSAGES = 50_000
"""Number of messages that can be skipped without a long wait: in one to three seconds."""
MIN_RECORDING_TIME = 8.0
"""Least recording time from which a moment's metrics are computed, except settling and counts [s]."""


class Film:
    """One recording for playing."""

    def __init__(self, recording: Recording) -> None:
        """Raises UnreadableError for a recording without any messages."""
        extent = recording.extent()
        if extent.start is None or extent.end is None:
            raise UnreadableError(f"{recording.path}: has no messages")
        self.start = extent.start
        """Time of the first message [s, the recorder's system clock]."""
        self.end = extent.end
        """Time of the last message [s]."""
        share = min(1.0, MAX_REBUILT_MESSAGES / max(extent.counts.total(), 1))
        self.stretch = max(MIN_RECORDING_TIME, share * (self.end - self.start))
        """Longest time of it that may be skipped at once [s]."""
        self._recording = recording

    def messages(self, since: float) -> Iterator[Recorded]:
        """Yield every message from the first one at or after `since` [s], in the order of the file."""
        return dropwhile(lambda message: message.wall < since, self._recording.messages(since))
