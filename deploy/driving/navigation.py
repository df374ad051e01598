"""Which goals of a ROS action, such as Nav2's navigate_to_pose, are active. Pure."""

from __future__ import annotations

from formation.ros2.goal_status import GoalStatus
from formation.ros2.messages import GoalStatuses

ACTIVE = frozenset({GoalStatus.ACCEPTED, GoalStatus.EXECUTING})
MAX_ENDED_GOALS = 1000
"""Most goals that are remembered as ended; the oldest are forgotten."""


class Navigation:
    """The goals of one action. A goal that has ended stays ended, whatever late or repeated messages say."""

    def __init__(self) -> None:
        self._active: frozenset[bytes] = frozenset()
        self._ended: dict[bytes, None] = {}

    @property
    def active(self) -> bool:
        """Whether the action works at a goal. Before the first message: no."""
        return bool(self._active)

    def take(self, statuses: GoalStatuses) -> str:
        """Take a message; return how the last active goal ended, if it did and not by success."""
        now = dict(statuses.statuses)
        before = self._active
        self._active = frozenset(
            goal for goal, status in now.items() if status in ACTIVE and goal not in self._ended
        )
        lost = before - self._active
        self._ended |= dict.fromkeys([*lost, *(goal for goal, status in now.items() if status not in ACTIVE)])
        for goal in list(self._ended)[:-MAX_ENDED_GOALS]:
            del self._ended[goal]
        found = {now.get(goal, GoalStatus.UNKNOWN) for goal in lost}
        if self._active or found <= {GoalStatus.SUCCEEDED}:
            return ""
        return " and ".join(sorted(one.name.lower() for one in found))
