"""The messages of a recording that a trace may name, for as long as one may."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from agent.trace import checksum
from formation.wire import Sample

KEPT = 10.0
"""So long a message may wait in the mailbox of an agent that hangs before a trace names it [s]."""


class Title(NamedTuple):
    """By which a message is found."""

    key: str
    checksum: int


class Shelf:
    """Messages by title. What is older than `KEPT` is gone, so a recording of any length fits."""

    def __init__(self) -> None:
        self._found: dict[Title, tuple[Sample, float]] = {}
        self._oldest: deque[tuple[float, Title]] = deque()

    def put(self, sample: Sample, moment: float) -> Title:
        """Keep a message that was recorded at `moment` [s]; moments never go back."""
        while self._oldest and self._oldest[0][0] < moment - KEPT:
            put, title = self._oldest.popleft()
            if self._found[title][1] == put:  # else the same was said again
                del self._found[title]
        title = Title(sample.key, checksum(sample))
        if title not in self._found or self._found[title][1] < moment:
            self._oldest.append((moment, title))
        self._found[title] = sample, moment
        return title

    def __contains__(self, title: Title) -> bool:
        return title in self._found

    def __getitem__(self, title: Title) -> Sample:
        return self._found[title][0]
