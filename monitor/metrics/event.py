"""An event, its message, and how often a change is reported."""

from __future__ import annotations

import re
from typing import NamedTuple

from formation.ros2.messages import LogEntry

INFO, WARNING, ERROR = 20, 30, 40
FORMATION = "formation"
"""The subject, on the wire, of an event about no robot."""
MAX_STAMP = 2.0**31 - 2.0
"""Largest stamp of an event [s], however an operator's clock is set."""
MAX_TEXT_CHARS = 500
"""Longest text of an event [characters]."""
BURST_CHANGES, REST_TIME = 6, 10.0
"""Number of changes reported at once, then the time per reported change [s]."""


_SET_BY = re.compile(r"was set by ([+-]\d{1,10}\.\d{6}) s$")


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


def clock_set(at: float, step: float) -> Event:
    """Return the event that our system clock was set by `step` [s], to `at` [s]."""
    return Event(at, WARNING, "", "clock", f"this computer's clock was set by {step:+.6f} s")


def clock_step(event: Event) -> float:
    """Return by how much the clock was set [s], the inverse of `clock_set`; 0 for another event."""
    found = _SET_BY.search(event.text) if event.kind == "clock" else None
    return float(found[1]) if found else 0.0


class RateLimit:
    """Allows `burst` reports at once, and after that one per `rest` [s]."""

    def __init__(self, burst: int, rest: float) -> None:
        self._burst, self._left, self._rest = float(burst), float(burst), rest
        self._at: float | None = None

    def allows(self, at: float) -> bool:
        """Return whether a report is allowed at `at` [s, monotonic]; if so, count it."""
        if self._at is not None:
            self._left = min(self._burst, self._left + (at - self._at) / self._rest)
        self._at = at
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Reported:
    """One changing state, and how often its changes are reported."""

    def __init__(self, state: str = "") -> None:
        """`state` is the initial one, which is not reported."""
        self.state = state
        self._unreported = 0
        self._pace = RateLimit(BURST_CHANGES, REST_TIME)

    def report(self, state: str, at: float) -> str | None:
        """Return None if `state` is not to be reported `at` [s, monotonic], else the end of the text.

        That has the number of changes that were not reported, if there were any. A state that changed and
        changed back unreported is reported, too.
        """
        if state != self.state:
            self.state, self._unreported = state, self._unreported + 1
        if not self._unreported or not self._pace.allows(at):
            return None
        before, self._unreported = self._unreported - 1, 0
        return f" ({before} changes before were not reported)" if before else ""
