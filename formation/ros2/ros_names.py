"""ROS 2 names of topics: a robot's logical key with its ROS namespace in place of its name.

Logical keys are those of the topic table, `robot2/odom`. A robot in the ROS namespace `lab/burger` calls
that topic `/lab/burger/odom`; ROS names are written here without their leading slash.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from formation.topics import CMD_VEL, TABLE, Topic, command_topic

_NAMESPACE = re.compile(r"(?:[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*)?")


def is_namespace(text: str) -> bool:
    """Whether `text` is a ROS namespace, without its leading slash; empty for the root."""
    return _NAMESPACE.fullmatch(text) is not None


Ros = Literal["ros2dds", "rmw_zenoh"]
"""Route from ROS 2 to Zenoh."""


class RosRobot(Protocol):
    """The part of a robot's mission entry that defines its ROS 2 names."""

    namespace: str | None
    """ROS namespace without its leading slash; None for the robot's own name."""
    ros: Ros
    """Its route from ROS 2 to Zenoh."""
    domain: int
    """ROS domain id."""
    cmd_vel: Literal["twist", "twist_stamped"]
    """Message type of its commands."""

    @property
    def measurable(self) -> tuple[str, ...]:
        """Robots that its sensors may measure."""


class Address(NamedTuple):
    """A logical key in parts."""

    topic: Topic
    robot: str
    """Empty for a topic of the whole formation."""
    other: str = ""

    @property
    def key(self) -> str:
        """The logical key."""
        return self.topic.key(self.robot, self.other)


_KINDS = tuple(
    (topic, re.compile(re.sub(r"\\\{(robot|other)\\\}", r"(?P<\1>[^/]+)", re.escape(topic.pattern))))
    for topic in sorted(TABLE, key=lambda topic: "{" in topic.pattern)  # formation/error before <robot>/error
)


def address(logical: str) -> Address:
    """The topic and robots of a logical key. ValueError for a key that is not in the table."""
    for topic, pattern in _KINDS:
        match = pattern.fullmatch(logical)
        if match:
            parts = match.groupdict("")
            return Address(topic, parts.get("robot", ""), parts.get("other", ""))
    raise ValueError(f"{logical!r} is no key of the topic table")


@dataclass(frozen=True, slots=True)
class RosNames:
    """The place in ROS of a robot, or of the formation as a whole, and the names of its topics."""

    robot: str = ""
    """Empty for the formation as a whole."""
    namespace: str = ""
    """Without leading slash; empty for the root."""
    sees: tuple[str, ...] = ()
    """Others that its sensors may measure."""
    ros: Ros = "ros2dds"
    domain: int = 0
    cmd_vel: Literal["twist", "twist_stamped"] = "twist"

    @classmethod
    def of(cls, name: str, robot: RosRobot) -> RosNames:
        """Return the names of the robot called `name`."""
        namespace = name if robot.namespace is None else robot.namespace
        return cls(name, namespace, robot.measurable, robot.ros, robot.domain, robot.cmd_vel)

    def spelled(self, logical: str) -> str:
        """ROS name of one of its logical keys, without leading slash."""
        own = logical.removeprefix(f"{self.robot}/")
        return f"{self.namespace}/{own}" if self.namespace else own

    def type(self, topic: Topic) -> str:
        """ROS type of a `topic` here; empty for a queryable."""
        return command_topic(self.cmd_vel).type if topic is CMD_VEL else topic.type

    def addresses(self) -> Iterator[Address]:
        """Every topic of this robot, or of the formation."""
        for topic in TABLE:
            if "{other}" in topic.pattern:
                yield from (Address(topic, self.robot, other) for other in self.sees)
            elif ("{robot}" in topic.pattern) == bool(self.robot):
                yield Address(topic, self.robot)

    def logical_keys(self) -> Iterator[str]:
        """Every logical key of this robot, or of the formation."""
        return (one.key for one in self.addresses())


def clash(robots: Mapping[str, RosNames]) -> tuple[str, str, str] | None:
    """Two of these `robots` with a ROS name in common, and that name; None if all names differ."""
    taken: dict[str, str] = {}
    for robot, names in robots.items():
        for one in names.addresses():
            name = names.spelled(one.key)
            if taken.setdefault(name, robot) != robot:
                return taken[name], robot, name
    return None
