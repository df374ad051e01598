"""Something that happened, and the message that tells it."""

from __future__ import annotations

from typing import NamedTuple

from formation.ros2.messages import LogEntry

INFO, WARNING, ERROR = 20, 30, 40
FORMATION = "formation"
"""Whom an event is about, on the wire, that is about no robot."""
LAST = 2.0**31 - 2.0
"""The last second that a stamp can say, however an operator's clock is set."""
LONGEST = 500
"""Letters of an event's text, at most."""


class Event(NamedTuple):
    """Something that happened."""

    at: float
    """[s, our system clock]"""
    level: int
    """20 for your information, 30 a warning, 40 an error."""
    robot: str
    """Whom it is about; empty for the formation."""
    kind: str
    """One word, such as ``joined``."""
    text: str


def to_message(event: Event) -> LogEntry:
    """The event as it is published and recorded."""
    at = min(max(event.at, 0.0), LAST)
    return LogEntry(at, event.level, event.robot or FORMATION, event.text[:LONGEST], event.kind)


def from_message(entry: LogEntry) -> Event:
    """The event that `to_message` made a message of."""
    robot = "" if entry.name == FORMATION else entry.name
    return Event(entry.stamp, entry.level, robot, entry.kind, entry.text)


def more(before: int) -> str:
    """What was not told before, in words."""
    return f" ({before} changes before were not told)" if before else ""
