"""An event, and its message."""

from __future__ import annotations

from typing import NamedTuple

from formation.ros2.messages import LogEntry

INFO, WARNING, ERROR = 20, 30, 40
FORMATION = "formation"
"""The subject, on the wire, of an event about no robot."""
MAX_STAMP = 2.0**31 - 2.0
"""Largest stamp of an event [s], however an operator's clock is set."""
MAX_TEXT_CHARS = 500
"""Longest text of an event [characters]."""


class Event(NamedTuple):
    """Something that happened in the formation."""

    at: float
    """[s, our system clock]"""
    level: int
    """20 information, 30 warning, 40 error."""
    robot: str
    """The robot concerned; empty for the formation."""
    kind: str
    """One word, such as ``joined``."""
    text: str


def to_message(event: Event) -> LogEntry:
    """Return the event as published and recorded."""
    at = min(max(event.at, 0.0), MAX_STAMP)
    return LogEntry(at, event.level, event.robot or FORMATION, event.text[:MAX_TEXT_CHARS], event.kind)


def from_message(entry: LogEntry) -> Event:
    """Return the event of a message: the inverse of `to_message`."""
    robot = "" if entry.name == FORMATION else entry.name
    return Event(entry.stamp, entry.level, robot, entry.kind, entry.text)


def more(before: int) -> str:
    """Return in words how many events were left out before."""
    return f" ({before} changes before were not reported)" if before else ""
