"""How often something may be told: at once as a rule, what keeps changing only now and then, with a count."""

from __future__ import annotations

BURST, REST = 6, 10.0
"""So many changes of one thing are told as they happen, then one per so many seconds."""


class Pace:
    """Lets `burst` through at once, and after that one per `rest` [s]."""

    def __init__(self, burst: int, rest: float) -> None:
        self._most, self._left, self._rest = float(burst), float(burst), rest
        self._at: float | None = None

    def may(self, at: float) -> bool:
        """Whether one more may be told at `at` [s, monotonic], which then counts as told."""
        if self._at is not None:
            self._left = min(self._most, self._left + (at - self._at) / self._rest)
        self._at = at
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Turns:
    """One thing that is now so and now so."""

    def __init__(self, state: str = "") -> None:
        """`state` is the one it begins in, of which nothing is told."""
        self.state = state
        self._untold = 0
        self._pace = Pace(BURST, REST)

    def see(self, state: str, at: float) -> int | None:
        """Whether `state` is to be told now, `at` [s, monotonic]: how many changes went untold before it.

        None for nothing to tell. What has changed back meanwhile is told as well, for its count.
        """
        if state != self.state:
            self.state, self._untold = state, self._untold + 1
        if not self._untold or not self._pace.may(at):
            return None
        before, self._untold = self._untold - 1, 0
        return before
