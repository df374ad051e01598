"""The messages of a recording that a trace may name, for as long as one may."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from agent.trace import checksum
from formation.wire import Sample

KEPT = 10.0
"""So long a message may wait in the mailbox of an agent that hangs before a trace names it [s]."""
MAX_BYTES = 256 * 1024 * 1024
"""Payloads that are kept at most [bytes]: ten seconds of 6,000 messages a second have 20 MB. A recording
whose clock stands still would be kept as a whole without this."""


class Title(NamedTuple):
    """By which a message is found."""

    key: str
    checksum: int


class Shelf:
    """Messages by title. What is older than `KEPT`, or too much, is gone: a recording of any length fits."""

    def __init__(self) -> None:
        self._found: dict[Title, tuple[Sample, float]] = {}
        self._oldest: deque[tuple[float, Title]] = deque()
        self._bytes = 0

    def put(self, sample: Sample, moment: float) -> Title:
        """Keep a message that was recorded at `moment` [s]; moments never go back."""
        while self._oldest and (self._oldest[0][0] < moment - KEPT or self._bytes > MAX_BYTES):
            put, title = self._oldest.popleft()
            if self._found[title][1] == put:  # else the same was said again
                self._bytes -= _size(self._found.pop(title)[0])
        title = Title(sample.key, checksum(sample))
        if title not in self._found or self._found[title][1] < moment:
            self._oldest.append((moment, title))
        if title in self._found:
            self._bytes -= _size(self._found[title][0])
        self._bytes += _size(sample)
        self._found[title] = sample, moment
        return title

    def __contains__(self, title: Title) -> bool:
        return title in self._found

    def __getitem__(self, title: Title) -> Sample:
        return self._found[title][0]


def _size(sample: Sample) -> int:
    """About what it takes in memory [bytes]."""
    return 500 + len(sample.payload) + len(sample.attachment or b"")
