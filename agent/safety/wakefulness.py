"""Detect that this process was frozen: messages that waited meanwhile are old, though they look new.

A process that was stopped (SIGSTOP, a suspended machine, no CPU for long) then reads the messages that
waited in its sockets, with the arrival time of now. So messages that arrive within `DRAIN_TIME` of waking are
refused, and nothing received before counts as fresh.
"""

from __future__ import annotations

from dataclasses import dataclass

from formation.protocol.order import LEADER_TIMEOUT_SECONDS

MAX_PAUSE = LEADER_TIMEOUT_SECONDS
"""Longest time between two steps of a process that was not frozen [s]; each makes at least two a second."""
DRAIN_TIME = 0.25
"""Time after waking in which messages that waited may still arrive [s]."""


@dataclass(slots=True)
class Wakefulness:
    """Whether one agent was frozen, by the times of its steps."""

    pause: float = 0.0
    """Length of the newest freeze, until it is over [s]; 0 if there is none."""
    stepped: float | None = None
    """Time of the newest step [s, monotonic]."""
    woke: float = float("-inf")
    """When the newest freeze ended [s, monotonic]."""

    def step(self, moment: float) -> bool:
        """Record a step at `moment` [s, monotonic]; whether the process has just woken from a freeze."""
        last, self.stepped = self.stepped, moment
        if last is None or moment - last <= MAX_PAUSE:
            return False
        self.pause, self.woke = moment - last, moment
        return True

    def waited(self, arrived: float) -> bool:
        """Whether a message that arrived then [s, monotonic] may have waited during a freeze."""
        return self.pause > 0.0 and arrived <= self.woke + DRAIN_TIME

    def confirm(self, *, beat_rose: float, follows: bool) -> None:
        """End the freeze once the leader's beat has risen since [s, monotonic], and the own pose follows."""
        if follows and beat_rose > self.woke:
            self.pause = 0.0
