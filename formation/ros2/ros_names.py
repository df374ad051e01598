"""ROS 2 names of topics: a robot's logical key with its ROS namespace in place of its name.

Logical keys are those of the topic table, `robot2/odom`. A robot in the ROS namespace `lab/burger` calls
that topic `/lab/burger/odom`; ROS names are written here without their leading slash.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from formation.topics import TABLE, Topic

_NAMESPACE = re.compile(r"(?:[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*)?")


def is_namespace(text: str) -> bool:
    """Whether `text` is a ROS namespace, without its leading slash; empty for the root."""
    return _NAMESPACE.fullmatch(text) is not None


Ros = Literal["ros2dds", "rmw_zenoh"]
"""Route from ROS 2 to Zenoh."""


class RosRobot(Protocol):
    """The part of a robot's mission entry that defines its ROS 2 names."""

    @property
    def namespace(self) -> str | None:
        """ROS namespace without its leading slash; None for the robot's own name."""

    @property
    def measurable(self) -> tuple[str, ...]:
        """Robots that its sensors may measure."""

    @property
    def ros(self) -> Ros:
        """Its route from ROS 2 to Zenoh."""

    @property
    def domain(self) -> int:
        """ROS domain id."""

    @property
    def cmd_vel(self) -> Literal["twist", "twist_stamped"]:
        """Message type of its commands."""


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
    """ROS names of one robot's topics."""

    robot: str
    namespace: str
    """Without leading slash; empty for the root."""
    sees: tuple[str, ...] = ()
    """Others that its sensors may measure."""

    @classmethod
    def of(cls, name: str, robot: RosRobot) -> RosNames:
        """Return the names of the robot called `name`."""
        return cls(name, name if robot.namespace is None else robot.namespace, robot.measurable)

    def name(self, topic: Topic, other: str = "") -> str:
        """ROS name of one of this robot's topics, without leading slash."""
        return self.spelled(topic.key(self.robot, other))

    def spelled(self, logical: str) -> str:
        """ROS name of one of this robot's logical keys."""
        own = logical.removeprefix(f"{self.robot}/")
        return f"{self.namespace}/{own}" if self.namespace else own

    def addresses(self) -> Iterator[Address]:
        """Every topic of this robot."""
        for topic in TABLE:
            if "{other}" in topic.pattern:
                yield from (Address(topic, self.robot, other) for other in self.sees)
            elif "{robot}" in topic.pattern:
                yield Address(topic, self.robot)


def clash(robots: Mapping[str, RosNames]) -> tuple[str, str, str] | None:
    """Two of these `robots` with a ROS name in common, and that name; None if all names differ."""
    taken: dict[str, str] = {}
    for robot, names in robots.items():
        for one in names.addresses():
            name = names.spelled(one.key)
            if taken.setdefault(name, robot) != robot:
                return taken[name], robot, name
    return None
