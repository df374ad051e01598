"""Limit how often changes are reported: rare ones at once, frequent ones at times, with a count."""

from __future__ import annotations

BURST_CHANGES, REST_TIME = 6, 10.0
"""Number of changes reported at once, then the time per reported change [s]."""


class Pace:
    """Allow `burst` at once, and after that one per `rest` [s]."""

    def __init__(self, burst: int, rest: float) -> None:
        self._most, self._left, self._rest = float(burst), float(burst), rest
        self._at: float | None = None

    def may(self, at: float) -> bool:
        """Return whether a report is allowed at `at` [s, monotonic]; if so, count it."""
        if self._at is not None:
            self._left = min(self._most, self._left + (at - self._at) / self._rest)
        self._at = at
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Turns:
    """Reports of one changing state."""

    def __init__(self, state: str = "") -> None:
        """`state` is the initial one, which is not reported."""
        self.state = state
        self._unreported = 0
        self._pace = Pace(BURST_CHANGES, REST_TIME)

    def update_state(self, state: str, at: float) -> int | None:
        """Return how many changes went unreported if `state` is to be reported `at` [s, monotonic].

        None if nothing is to be reported. A state that changed back meanwhile is reported too, for its count.
        """
        if state != self.state:
            self.state, self._unreported = state, self._unreported + 1
        if not self._unreported or not self._pace.may(at):
            return None
        before, self._unreported = self._unreported - 1, 0
        return before
