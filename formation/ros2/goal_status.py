"""What an action, such as Nav2's navigate_to_pose, tells of its goals: their states and its progress."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Self

from formation.ros2 import ros
from formation.ros2.cdr import Reader, Writer
from formation.ros2.ros import Message
from formation.wire import BadMessage

ID_BYTES = 16
"""Length of a goal's id."""


class GoalStatus(IntEnum):
    """How far an action is with one goal."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@dataclass(frozen=True, slots=True)
class GoalStatuses(Message):
    """action_msgs/GoalStatusArray: a goal's id (16 bytes) and status; when it was accepted is not read."""

    ROS_TYPE: ClassVar[str] = "action_msgs/msg/GoalStatusArray"
    DEFINITION: ClassVar[str] = "action_msgs/GoalStatus[] status_list\n"
    TYPE_HASH: ClassVar[str] = "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    statuses: tuple[tuple[bytes, GoalStatus], ...]

    def _write(self, to: Writer) -> None:
        to.count(len(self.statuses))
        for goal, status in self.statuses:
            for octet in goal:
                to.octet(octet)
            ros.write_stamp(to, 0.0)
            to.octet(status)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        statuses = []
        for _ in range(source.count()):
            goal = bytes(source.octet() for _ in range(ID_BYTES))
            ros.read_stamp(source)
            statuses.append((goal, _status(source.octet())))
        return cls(tuple(statuses))


def feedback_goal(payload: bytes) -> bytes:
    """Return the id of the goal that a feedback message is about, of any action's type. Raises BadMessage."""
    source = Reader(payload)
    return bytes(source.octet() for _ in range(ID_BYTES))


def _status(status: int) -> GoalStatus:
    try:
        return GoalStatus(status)
    except ValueError:
        raise BadMessage(f"status is {status}, must be from 0 (unknown) to 6 (aborted)") from None
