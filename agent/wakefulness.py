"""Was this process frozen? What waited for it meanwhile is old, however new it looks.

A process that was stopped (SIGSTOP, a suspended machine, no CPU for long) reads on waking what waited in its
sockets, with the arrival time of now. So whatever arrives within `DRAIN` of waking is refused, and nothing
heard before counts as fresh.
"""

from __future__ import annotations

from formation.order import LEADER_LOST

MAX_PAUSE = LEADER_LOST
"""Longest time between two steps of a process that was not frozen [s]; each takes at least two a second."""
DRAIN = 0.25
"""For so long after waking, messages that waited may still come in [s]."""


class Wakefulness:
    """Whether one agent was frozen, by the times of its steps."""

    def __init__(self) -> None:
        self.pause = 0.0
        """Length of the newest freeze that is not over yet [s]; 0 if there is none."""
        self._stepped: float | None = None  # newest step [s, monotonic]
        self._woke = float("-inf")  # [s, monotonic]

    def step(self, moment: float) -> bool:
        """A step is taken at `moment` [s, monotonic]; whether the process has just woken from a freeze."""
        last, self._stepped = self._stepped, moment
        if last is None or moment - last <= MAX_PAUSE:
            return False
        self.pause, self._woke = moment - last, moment
        return True

    def waited(self, arrived: float) -> bool:
        """Whether a message that arrived then [s, monotonic] may have waited while the process was frozen."""
        return self.pause > 0.0 and arrived <= self._woke + DRAIN

    def confirm(self, *, beat_rose: float, follows: bool) -> None:
        """End the freeze once the leader's beat has risen since [s, monotonic], and the own pose follows."""
        if follows and beat_rose > self._woke:
            self.pause = 0.0
