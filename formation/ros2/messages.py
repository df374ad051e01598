"""The messages on the wire: plain frozen values here, standard ROS 2 messages in CDR outside.

`encode` and `decode` are the only way out and in. `decode` accepts exactly what a controller can use:
whatever is wrong with the bytes (length, header, type, numbers that are not finite or not physical, a robot
that is not upright) is one BadMessage.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, TypeVar, cast

from rosbags.serde import SerdeError
from rosbags.typesys.stores.ros2_jazzy import diagnostic_msgs__msg__DiagnosticArray as RosDiagnosticArray
from rosbags.typesys.stores.ros2_jazzy import diagnostic_msgs__msg__DiagnosticStatus as RosDiagnosticStatus
from rosbags.typesys.stores.ros2_jazzy import diagnostic_msgs__msg__KeyValue as RosKeyValue
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PointStamped as RosPointStamped
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseStamped as RosPoseStamped
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Twist as RosTwist
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__TwistStamped as RosTwistStamped
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__Odometry as RosOdometry
from rosbags.typesys.stores.ros2_jazzy import rcl_interfaces__msg__Log as RosLog
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Float64 as RosFloat64
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__String as RosString

from formation.ros2 import quick, ros
from formation.ros2.ros import definition, type_hash
from formation.wire import BadMessage

__all__ = [
    "MAX_BYTES",
    "BadMessage",
    "Diagnostics",
    "Displacement",
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
    "definition",
    "encode",
    "type_hash",
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

    def _to_ros(self) -> RosOdometry:
        pose, twist = ros.to_pose(self.position, self.heading), ros.to_twist(self.speed, self.turn_rate)
        header = ros.to_header(self.stamp, self.frame)
        return RosOdometry(header, ros.to_text(self.child_frame), *ros.without_covariance(pose, twist))

    @classmethod
    def _from_ros(cls, raw: RosOdometry) -> Self:
        position, heading = ros.from_pose(raw.pose.pose)
        speed, turn_rate = ros.from_twist(raw.twist.twist)
        stamp, frame = ros.from_header(raw.header)
        return cls(stamp, position, heading, speed, turn_rate, frame, ros.from_text(raw.child_frame_id))


@dataclass(frozen=True, slots=True)
class Twist:
    """geometry_msgs/Twist: a command [m/s; rad/s]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/Twist"
    speed: float
    turn_rate: float

    def _to_ros(self) -> RosTwist:
        return ros.to_twist(self.speed, self.turn_rate)

    @classmethod
    def _from_ros(cls, raw: RosTwist) -> Self:
        return cls(*ros.from_twist(raw))


@dataclass(frozen=True, slots=True)
class TwistStamped:
    """geometry_msgs/TwistStamped: a command [m/s; rad/s] with its time [s, sender's system clock]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    stamp: float
    speed: float
    turn_rate: float
    frame: str = "base_footprint"

    def _to_ros(self) -> RosTwistStamped:
        return RosTwistStamped(
            ros.to_header(self.stamp, self.frame), ros.to_twist(self.speed, self.turn_rate)
        )

    @classmethod
    def _from_ros(cls, raw: RosTwistStamped) -> Self:
        stamp, frame = ros.from_header(raw.header)
        return cls(stamp, *ros.from_twist(raw.twist), frame)


@dataclass(frozen=True, slots=True)
class Pose:
    """geometry_msgs/PoseStamped: axle midpoint [m; `frame`], heading e^{iθ}, stamp [s, sender's clock]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PoseStamped"
    stamp: float
    position: complex
    heading: complex
    frame: str = "map"

    def _to_ros(self) -> RosPoseStamped:
        return RosPoseStamped(ros.to_header(self.stamp, self.frame), ros.to_pose(self.position, self.heading))

    @classmethod
    def _from_ros(cls, raw: RosPoseStamped) -> Self:
        stamp, frame = ros.from_header(raw.header)
        return cls(stamp, *ros.from_pose(raw.pose), frame)


@dataclass(frozen=True, slots=True)
class Displacement:
    """geometry_msgs/PointStamped: from a robot's control point to another's [m; body frame]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PointStamped"
    stamp: float
    displacement: complex
    frame: str = "base_footprint"

    def _to_ros(self) -> RosPointStamped:
        return RosPointStamped(
            ros.to_header(self.stamp, self.frame), ros.to_point("displacement", self.displacement)
        )

    @classmethod
    def _from_ros(cls, raw: RosPointStamped) -> Self:
        stamp, frame = ros.from_header(raw.header)
        return cls(stamp, ros.from_point("displacement", raw.point), frame)


@dataclass(frozen=True, slots=True)
class Number:
    """std_msgs/Float64, finite."""

    ROS_TYPE: ClassVar[str] = "std_msgs/msg/Float64"
    value: float

    def _to_ros(self) -> RosFloat64:
        ros.within("value", sys.float_info.max, self.value)
        return RosFloat64(self.value)

    @classmethod
    def _from_ros(cls, raw: RosFloat64) -> Self:
        ros.within("value", sys.float_info.max, raw.data)
        return cls(raw.data)


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

    def _to_ros(self) -> RosDiagnosticArray:
        return RosDiagnosticArray(ros.to_header(self.stamp, ""), [_to_status(s) for s in self.statuses])

    @classmethod
    def _from_ros(cls, raw: RosDiagnosticArray) -> Self:
        return cls(ros.from_header(raw.header)[0], tuple(_from_status(s) for s in raw.status))


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

    def _to_ros(self) -> RosLog:
        stamp = ros.to_header(self.stamp, "").stamp
        name, text, kind = map(ros.to_text, (self.name, self.text, self.kind))
        return RosLog(stamp, _log_level(self.level), name, text, "", kind, 0)

    @classmethod
    def _from_ros(cls, raw: RosLog) -> Self:
        stamp = ros.from_stamp(raw.stamp)
        name, text, kind = map(ros.from_text, (raw.name, raw.msg, raw.function))
        return cls(stamp, _log_level(raw.level), name, text, kind)


@dataclass(frozen=True, slots=True)
class Text:
    """std_msgs/String, printable."""

    ROS_TYPE: ClassVar[str] = "std_msgs/msg/String"
    text: str

    def _to_ros(self) -> RosString:
        return RosString(ros.to_text(self.text))

    @classmethod
    def _from_ros(cls, raw: RosString) -> Self:
        return cls(ros.from_text(raw.data))


Message = Odometry | Twist | TwistStamped | Pose | Displacement | Number | Diagnostics | LogEntry | Text
M = TypeVar("M", Odometry, Twist, TwistStamped, Pose, Displacement, Number, Diagnostics, LogEntry, Text)

_QUICK: dict[type, Callable[[bytes], tuple[Any, ...] | None]] = {
    Odometry: quick.odometry,
    Pose: quick.pose,
    Twist: quick.twist,
    TwistStamped: quick.twist_stamped,
}


def encode(message: Message) -> bytes:
    """CDR, little endian. Raises BadMessage for what no receiver would accept."""
    raw = message._to_ros()  # noqa: SLF001 - the two halves of one codec
    payload = bytes(ros.STORE.serialize_cdr(raw, message.ROS_TYPE, little_endian=True))
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{message.ROS_TYPE}: {len(payload)} bytes, at most {MAX_BYTES} may be sent")
    return payload


def decode(cls: type[M], payload: bytes) -> M:
    """The `cls` in `payload`, CDR of either byte order. Raises BadMessage, nothing else, if it is not one."""
    reader = _QUICK.get(cls)
    if reader is not None and (fields := reader(payload)) is not None:
        return cls(*fields)
    return _decode_any(cls, payload)


def _decode_any(cls: type[M], payload: bytes) -> M:
    """The same for whatever form the message has."""
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{cls.ROS_TYPE}: {len(payload)} bytes, at most {MAX_BYTES} are read")
    # 00, byte order, 00, number of padding bytes at the end of the payload
    if len(payload) <= 4 or payload[0] or payload[1] > 1 or payload[2] or payload[3] > 3:
        raise BadMessage(f"{cls.ROS_TYPE}: no CDR header but {payload[:4].hex(' ') or 'nothing'}")
    try:
        return cls._from_ros(cast("Any", ros.STORE.deserialize_cdr(payload, cls.ROS_TYPE)))
    except (SerdeError, BadMessage) as error:
        raise BadMessage(f"{cls.ROS_TYPE}: {error}") from None


def _to_status(status: Status) -> RosDiagnosticStatus:
    name, message, hardware_id = map(ros.to_text, (status.name, status.message, status.hardware_id))
    pairs = [RosKeyValue(ros.to_text(k), ros.to_text(v)) for k, v in status.values.items()]
    return RosDiagnosticStatus(_level(status.level), name, message, hardware_id, pairs)


def _from_status(raw: RosDiagnosticStatus) -> Status:
    name, message, hardware_id = map(ros.from_text, (raw.name, raw.message, raw.hardware_id))
    values = {ros.from_text(pair.key): ros.from_text(pair.value) for pair in raw.values}
    return Status(name, _level(raw.level), message, hardware_id, values)


def _level(level: int) -> int:
    if level not in range(4):
        raise BadMessage(f"level is {level}, must be 0 (ok), 1 (warning), 2 (error) or 3 (stale)")
    return level


def _log_level(level: int) -> int:
    if level not in {10, 20, 30, 40, 50}:
        raise BadMessage(f"level is {level}, must be 10 (debug), 20, 30, 40 or 50 (fatal)")
    return level
