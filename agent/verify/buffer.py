"""The messages of a recording, for as long as a trace may name them."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from formation.agent.persistence.trace import checksum
from formation.wire import Sample

MAX_STORED_TIME = 10.0
"""Longest time that a message may wait in a blocked agent's mailbox before a trace names it [s]."""
MAX_BYTES = 256 * 1024 * 1024
"""Most bytes of payload that are kept: ten seconds of 6,000 messages a second have 20 MB. Without this, a
recording with a stopped clock would be kept as a whole."""


class Title(NamedTuple):
    """Key by which a message is found."""

    key: str
    checksum: int


class MessageBuffer:
    """Messages by title. Those older than `MAX_STORED_TIME`, or in excess, are dropped."""

    def __init__(self) -> None:
        self._found: dict[Title, tuple[Sample, float]] = {}
        self._oldest: deque[tuple[float, Title]] = deque()
        self._bytes = 0

    def put(self, sample: Sample, moment: float) -> Title:
        """Store a message recorded at `moment` [s]; moments never go back."""
        while self._oldest and (self._oldest[0][0] < moment - MAX_STORED_TIME or self._bytes > MAX_BYTES):
            put, title = self._oldest.popleft()
            if self._found[title][1] == put:  # else the same message was repeated
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
    """Approximate size in memory [bytes]."""
    return 500 + len(sample.payload) + len(sample.attachment or b"")
