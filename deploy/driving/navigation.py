"""Which goals of a ROS action, such as Nav2's navigate_to_pose, are active, and whether it works. Pure."""

from __future__ import annotations

import math
from types import MappingProxyType

from formation.ros2.goal_status import GoalStatus
from formation.ros2.messages import GoalStatuses

ACTIVE = frozenset({GoalStatus.ACCEPTED, GoalStatus.EXECUTING})
ENDS = MappingProxyType(
    {
        GoalStatus.UNKNOWN: "forgotten",
        GoalStatus.CANCELING: "canceled",
        GoalStatus.CANCELED: "canceled",
        GoalStatus.ABORTED: "aborted",
    }
)
"""How a goal ended, for people."""
FEEDBACK_SECONDS = 2.0
"""Longest silence of the feedback of an action that works at a goal [s]. Nav2 sends it 100 times a second."""
MAX_ENDED_GOALS = 1000
"""Most goals that are remembered as ended; the oldest are forgotten."""


class Navigation:
    """The goals of one action. A goal that has ended stays ended, whatever late or repeated messages say."""

    def __init__(self) -> None:
        self._active: frozenset[bytes] = frozenset()
        self._ended: dict[bytes, None] = {}
        self._progress_at = -math.inf
        """When a goal was accepted, or feedback about one arrived [s, monotonic]."""

    @property
    def active(self) -> bool:
        """Whether a goal is accepted and has not ended. Before the first message: no."""
        return bool(self._active)

    def note_feedback(self, goal: bytes, moment: float) -> None:
        """Take feedback about a goal that arrived at `moment` [s, monotonic]."""
        if goal in self._active:
            self._progress_at = max(self._progress_at, moment)

    def works(self, moment: float) -> bool:
        """Whether the action works at an active goal at `moment` [s, monotonic]: it has just said so."""
        return self.active and moment - self._progress_at <= FEEDBACK_SECONDS

    def update(self, statuses: GoalStatuses, moment: float) -> str:
        """Take statuses that arrived at `moment` [s, monotonic].

        Returns how the last active goals ended, if they did and not by success. A goal that the action no
        longer lists has ended.
        """
        now = dict(statuses.statuses)
        before = self._active
        self._active = frozenset(
            goal for goal, status in now.items() if status in ACTIVE and goal not in self._ended
        )
        if self._active - before:
            self._progress_at = max(self._progress_at, moment)
        lost = before - self._active
        self._ended |= dict.fromkeys([*lost, *(goal for goal, status in now.items() if status not in ACTIVE)])
        for goal in list(self._ended)[:-MAX_ENDED_GOALS]:
            del self._ended[goal]
        found = {now.get(goal, GoalStatus.UNKNOWN) for goal in lost} - {GoalStatus.SUCCEEDED}
        return "" if self._active else " and ".join(sorted({ENDS[status] for status in found}))
