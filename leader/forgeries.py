"""Robots that relay forged orders: which ones, and when to raise the alarm."""

from __future__ import annotations

FORGERY_TIME = 10.0
"""How long a robot is named after its newest forged order; the alarm repeats after as long a silence [s]."""


class Forgeries:
    """The forged orders that one candidate has received."""

    def __init__(self) -> None:
        self._received: dict[str, tuple[int, str, float]] = {}  # by robot: how many, why, when [s, monotonic]

    def receive(self, robot: str, why: str, mono: float) -> bool:
        """Count a forged order; return whether it is the first of `robot` within `FORGERY_TIME`."""
        count, _, when = self._received.get(robot, (0, "", float("-inf")))
        self._received[robot] = count + 1, why, mono
        return mono - when > FORGERY_TIME

    def lately(self, mono: float) -> dict[str, tuple[int, str]]:
        """Return by robot the number of forged orders so far, and what was wrong with the newest."""
        return {
            robot: (count, why)
            for robot, (count, why, when) in self._received.items()
            if mono - when <= FORGERY_TIME
        }
