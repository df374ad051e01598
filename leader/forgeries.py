"""Robots that relay orders which no leader gave: who they are, and when to raise the alarm."""

from __future__ import annotations

LATELY = 10.0
"""A robot is named for so long after the newest [s], and the alarm raised anew after as long a silence."""


class Forgeries:
    """What one candidate has heard of them."""

    def __init__(self) -> None:
        self._heard: dict[str, tuple[int, str, float]] = {}  # by robot: how many, why, when [s, monotonic]

    def hear(self, robot: str, why: str, mono: float) -> bool:
        """Take one in; whether it is the first of `robot` in a while."""
        count, _, when = self._heard.get(robot, (0, "", float("-inf")))
        self._heard[robot] = count + 1, why, mono
        return mono - when > LATELY

    def lately(self, mono: float) -> dict[str, str]:
        """By robot: how many orders so far, and what was wrong with the newest."""
        return {
            robot: f"{count}, last: {why}"
            for robot, (count, why, when) in self._heard.items()
            if mono - when <= LATELY
        }
