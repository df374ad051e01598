"""One example message of each class."""

from __future__ import annotations

import cmath
import math
from typing import Any

from formation.ros2.goal_status import GoalStatus
from formation.ros2.messages import (
    Diagnostics,
    Displacement,
    GoalStatuses,
    LaserScan,
    LogEntry,
    Message,
    Number,
    Odometry,
    Pose,
    Status,
    Text,
    Twist,
    TwistStamped,
    decode,
)

NOW = 1_763_687_000.25
ODOMETRY = Odometry(NOW, 1 - 2j, 1j, 0.2, -0.5)
EXAMPLES: tuple[Message, ...] = (
    ODOMETRY,
    Twist(0.1, -0.2),
    TwistStamped(NOW, 0.1, -0.2),
    Pose(NOW, 3 - 4j, cmath.rect(1.0, 2.0)),
    Displacement(NOW, 0.5 + 1j),
    Number(0.25),
    Diagnostics(
        NOW,
        (Status("agent", 1, "no neighbour", "robot2", {"state": "run", "u": "0.1"}), Status("b", 0, "ok")),
    ),
    LogEntry(NOW, 30, "robot2", "held: no fresh neighbour", "held"),
    Text('{"publisher_id":"a"}'),
    GoalStatuses(((bytes(range(16)), GoalStatus.EXECUTING), (bytes(16), GoalStatus.CANCELED))),
    LaserScan(NOW, -0.5, 0.25, 0.125, 3.5, (0.5, math.inf, 0.0, 3.25, -math.inf), 0.03125, 0.25),
)
CLASSES: tuple[type[Any], ...] = tuple(type(example) for example in EXAMPLES)


def read(like: Message, payload: bytes) -> Message:
    """Decode `payload` as a message of the same class as `like`."""
    cls: type[Any] = type(like)
    message: Message = decode(cls, payload)
    return message


def same(a: Message, b: Message) -> bool:
    """Whether two messages are equal, up to rounding of the heading, which is sent as a quaternion."""
    names = vars(type(a))["__dataclass_fields__"]
    return type(a) is type(b) and all(
        abs(getattr(a, name) - getattr(b, name)) < 1e-15
        if name == "heading"
        else getattr(a, name) == getattr(b, name)
        for name in names
        if name != "ROS_TYPE"
    )
