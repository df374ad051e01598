"""The messages on the wire: plain frozen values here, standard ROS 2 messages in CDR outside.

`encode` and `decode` are the only way out and in. `decode` accepts exactly what a controller can use:
whatever is wrong with the bytes (length, header, type, numbers that are not finite or not physical, a robot
that is not upright) is one BadMessage.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Self, TypeVar

from formation.ros2 import ros
from formation.ros2.cdr import Reader, Writer
from formation.ros2.laser_scan import LaserScan
from formation.wire import BadMessage

__all__ = [
    "MAX_BYTES",
    "BadMessage",
    "Diagnostics",
    "Displacement",
    "LaserScan",
    "LogEntry",
    "Message",
    "Number",
    "Odometry",
    "Pose",
    "Status",
    "Text",
    "Twist",
    "TwistStamped",
    "decode",
    "encode",
]

MAX_BYTES = 64 * 1024
"""Longest payload that is read at all; an Odometry has 724 bytes."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """nav_msgs/Odometry: where a robot is and how it moves."""

    ROS_TYPE: ClassVar[str] = "nav_msgs/msg/Odometry"
    stamp: float
    """[s, sender's system clock]"""
    position: complex
    """Axle midpoint [m; `frame`]."""
    heading: complex
    """e^{iθ}, unit [`frame`]."""
    speed: float
    """Forward [m/s]."""
    turn_rate: float
    """[rad/s]"""
    frame: str = "map"
    child_frame: str = "base_footprint"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_text(to, self.child_frame)
        ros.write_pose(to, self.position, self.heading)
        to.zeros(ros.COVARIANCE)
        ros.write_twist(to, self.speed, self.turn_rate)
        to.zeros(ros.COVARIANCE)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        child_frame = ros.read_text(source)
        position, heading = ros.read_pose(source)
        source.skip(ros.COVARIANCE)
        speed, turn_rate = ros.read_twist(source)
        source.skip(ros.COVARIANCE)
        return cls(stamp, position, heading, speed, turn_rate, frame, child_frame)


@dataclass(frozen=True, slots=True)
class Twist:
    """geometry_msgs/Twist: a command [m/s; rad/s]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/Twist"
    speed: float
    turn_rate: float

    def _write(self, to: Writer) -> None:
        ros.write_twist(to, self.speed, self.turn_rate)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        return cls(*ros.read_twist(source))


@dataclass(frozen=True, slots=True)
class TwistStamped:
    """geometry_msgs/TwistStamped: a command [m/s; rad/s] with its time [s, sender's system clock]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    stamp: float
    speed: float
    turn_rate: float
    frame: str = "base_footprint"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_twist(to, self.speed, self.turn_rate)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        return cls(stamp, *ros.read_twist(source), frame)


@dataclass(frozen=True, slots=True)
class Pose:
    """geometry_msgs/PoseStamped: axle midpoint [m; `frame`], heading e^{iθ}, stamp [s, sender's clock]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PoseStamped"
    stamp: float
    position: complex
    heading: complex
    frame: str = "map"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_pose(to, self.position, self.heading)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        return cls(stamp, *ros.read_pose(source), frame)


@dataclass(frozen=True, slots=True)
class Displacement:
    """geometry_msgs/PointStamped: from a robot's control point to another's [m; body frame]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PointStamped"
    stamp: float
    displacement: complex
    frame: str = "base_footprint"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_point(to, "displacement", self.displacement)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        return cls(stamp, ros.read_point(source, "displacement"), frame)


@dataclass(frozen=True, slots=True)
class Number:
    """std_msgs/Float64, finite."""

    ROS_TYPE: ClassVar[str] = "std_msgs/msg/Float64"
    value: float

    def _write(self, to: Writer) -> None:
        ros.within("value", sys.float_info.max, self.value)
        to.doubles(self.value)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        (value,) = source.doubles(1)
        ros.within("value", sys.float_info.max, value)
        return cls(value)


@dataclass(frozen=True, slots=True)
class Status:
    """diagnostic_msgs/DiagnosticStatus: how one thing is."""

    name: str
    level: int
    """0 ok, 1 warning, 2 error, 3 stale."""
    message: str
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """diagnostic_msgs/DiagnosticArray: several statuses of one moment [s, sender's system clock]."""

    ROS_TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"
    stamp: float
    statuses: tuple[Status, ...]

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, "")
        to.count(len(self.statuses))
        for status in self.statuses:
            _write_status(to, status)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, _ = ros.read_header(source)
        return cls(stamp, tuple(_read_status(source) for _ in range(source.count())))


@dataclass(frozen=True, slots=True)
class LogEntry:
    """rcl_interfaces/Log: something that happened, in words."""

    ROS_TYPE: ClassVar[str] = "rcl_interfaces/msg/Log"
    stamp: float
    """[s, sender's system clock]"""
    level: int
    """10 debug, 20 info, 30 warning, 40 error, 50 fatal."""
    name: str
    """Whom it is about."""
    text: str
    kind: str = ""
    """What kind of thing it was, in one word; ROS calls the field `function`."""

    def _write(self, to: Writer) -> None:
        ros.write_stamp(to, self.stamp)
        to.octet(_log_level(self.level))
        for text in (self.name, self.text, "", self.kind):  # the third is a file …
            ros.write_text(to, text)
        to.count(0)  # … and this a line in it

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, level = ros.read_stamp(source), _log_level(source.octet())
        name, text = ros.read_text(source), ros.read_text(source)
        source.text()
        kind = ros.read_text(source)
        source.count()
        return cls(stamp, level, name, text, kind)


@dataclass(frozen=True, slots=True)
class Text:
    """std_msgs/String, printable."""

    ROS_TYPE: ClassVar[str] = "std_msgs/msg/String"
    text: str

    def _write(self, to: Writer) -> None:
        ros.write_text(to, self.text)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        return cls(ros.read_text(source))


Message = (
    Odometry | Twist | TwistStamped | Pose | Displacement | Number | Diagnostics | LogEntry | Text | LaserScan
)
M = TypeVar(
    "M", Odometry, Twist, TwistStamped, Pose, Displacement, Number, Diagnostics, LogEntry, Text, LaserScan
)


def encode(message: Message) -> bytes:
    """CDR, little endian. Raises BadMessage for what no receiver would accept."""
    to = Writer()
    message._write(to)  # noqa: SLF001 - the two halves of one codec
    payload = to.written()
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{message.ROS_TYPE}: {len(payload)} bytes, at most {MAX_BYTES} may be sent")
    return payload


def decode(cls: type[M], payload: bytes) -> M:
    """The `cls` in `payload`, CDR of either byte order. Raises BadMessage, nothing else, if it is not one."""
    try:
        if len(payload) > MAX_BYTES:
            raise BadMessage(f"{len(payload)} bytes, at most {MAX_BYTES} are read")
        source = Reader(payload)
        message = cls._read(source)
        source.end()
    except BadMessage as error:
        raise BadMessage(f"{cls.ROS_TYPE}: {error}") from None
    return message


def _write_status(to: Writer, status: Status) -> None:
    to.octet(_level(status.level))
    for text in (status.name, status.message, status.hardware_id):
        ros.write_text(to, text)
    to.count(len(status.values))
    for pair in status.values.items():
        for text in pair:
            ros.write_text(to, text)


def _read_status(source: Reader) -> Status:
    level = _level(source.octet())
    name, message, hardware_id = (ros.read_text(source) for _ in range(3))
    values = {ros.read_text(source): ros.read_text(source) for _ in range(source.count())}
    return Status(name, level, message, hardware_id, values)


def _level(level: int) -> int:
    if level not in range(4):
        raise BadMessage(f"level is {level}, must be 0 (ok), 1 (warning), 2 (error) or 3 (stale)")
    return level


def _log_level(level: int) -> int:
    if level not in {10, 20, 30, 40, 50}:
        raise BadMessage(f"level is {level}, must be 10 (debug), 20, 30, 40 or 50 (fatal)")
    return level
