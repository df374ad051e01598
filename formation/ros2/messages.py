"""The messages on the wire: plain frozen values here, standard ROS 2 messages in CDR outside.

Messages are converted only by `encode` and `decode`. `decode` accepts exactly what a controller can use:
any fault in the bytes (length, header, type, numbers that are not finite or not physical, a robot that is
not upright) is one BadMessage.
"""

from __future__ import annotations

import math
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self, TypeVar

from formation.ros2 import ros
from formation.ros2.cdr import Reader, Writer
from formation.ros2.diagnostics import Diagnostics, LogEntry, Status
from formation.ros2.goal_status import GoalStatuses
from formation.ros2.laser_scan import LaserScan
from formation.ros2.ros import MAX_PAYLOAD_BYTES, Message
from formation.wire import BadMessage

__all__ = [
    "MAX_PAYLOAD_BYTES",
    "WORLD_FRAME",
    "BadMessage",
    "Diagnostics",
    "Displacement",
    "GoalStatuses",
    "LaserScan",
    "LogEntry",
    "MapPose",
    "Message",
    "Number",
    "Odometry",
    "Path",
    "Pose",
    "Status",
    "Text",
    "Transform",
    "Transforms",
    "Twist",
    "TwistStamped",
    "decode",
    "encode",
]

WORLD_FRAME = "map"
"""Name of the world frame in messages and transforms."""


@dataclass(frozen=True, slots=True)
class Odometry(Message):
    """nav_msgs/Odometry: a robot's pose and speeds."""

    ROS_TYPE: ClassVar[str] = "nav_msgs/msg/Odometry"
    DEFINITION: ClassVar[str] = (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n"
    )
    TYPE_HASH: ClassVar[str] = "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
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
    frame: str = WORLD_FRAME
    child_frame: str = "base_footprint"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_text(to, self.child_frame)
        ros.write_pose(to, self.position, self.heading)
        to.zeros(ros.COVARIANCE_LENGTH)
        ros.write_twist(to, self.speed, self.turn_rate)
        to.zeros(ros.COVARIANCE_LENGTH)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        child_frame = ros.read_text(source)
        position, heading = ros.read_pose(source)
        source.skip(ros.COVARIANCE_LENGTH)
        speed, turn_rate = ros.read_twist(source)
        source.skip(ros.COVARIANCE_LENGTH)
        return cls(stamp, position, heading, speed, turn_rate, frame, child_frame)


@dataclass(frozen=True, slots=True)
class Twist(Message):
    """geometry_msgs/Twist: a command [m/s; rad/s]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/Twist"
    DEFINITION: ClassVar[str] = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
    TYPE_HASH: ClassVar[str] = "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
    speed: float
    turn_rate: float

    def _write(self, to: Writer) -> None:
        ros.write_twist(to, self.speed, self.turn_rate)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        return cls(*ros.read_twist(source))


@dataclass(frozen=True, slots=True)
class TwistStamped(Message):
    """geometry_msgs/TwistStamped: a command [m/s; rad/s] with its time [s, sender's system clock]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    DEFINITION: ClassVar[str] = "std_msgs/Header header\ngeometry_msgs/Twist twist\n"
    TYPE_HASH: ClassVar[str] = "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"
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
class Pose(Message):
    """geometry_msgs/PoseStamped: axle midpoint [m; `frame`], heading e^{iθ}, stamp [s, sender's clock]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PoseStamped"
    DEFINITION: ClassVar[str] = "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    TYPE_HASH: ClassVar[str] = "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
    stamp: float
    position: complex
    heading: complex
    frame: str = WORLD_FRAME

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_pose(to, self.position, self.heading)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        return cls(stamp, *ros.read_pose(source), frame)


@dataclass(frozen=True, slots=True)
class Path(Message):
    """nav_msgs/Path: its positions [m; `frame`]."""

    ROS_TYPE: ClassVar[str] = "nav_msgs/msg/Path"
    DEFINITION: ClassVar[str] = "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n"
    TYPE_HASH: ClassVar[str] = "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"
    MAX_BYTES: ClassVar[int] = 1024 * 1024
    """Planners give a pose of 72 bytes for each 2 to 5 cm: enough for 300 m."""
    stamp: float
    """[s, sender's system clock]"""
    positions: tuple[complex, ...]
    frame: str = WORLD_FRAME

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        to.count(len(self.positions))
        for position in self.positions:
            ros.write_header(to, self.stamp, self.frame)
            ros.write_pose(to, position, 1.0 + 0.0j)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        positions: list[complex] = []
        for _ in range(source.count()):
            _, own = ros.read_header(source)
            if own.removeprefix("/") not in {"", frame.removeprefix("/")}:
                number = len(positions) + 1
                raise BadMessage(f"pose {number} is in frame {own}, the path in frame {frame or 'none'}")
            positions.append(ros.read_pose(source)[0])
        return cls(stamp, tuple(positions), frame)


@dataclass(frozen=True, slots=True)
class MapPose(Message):
    """geometry_msgs/PoseWithCovarianceStamped: a pose in a map, as AMCL publishes it, and its deviations."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PoseWithCovarianceStamped"
    DEFINITION: ClassVar[str] = "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n"
    TYPE_HASH: ClassVar[str] = "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    stamp: float
    """[s, sender's system clock]"""
    position: complex
    """[m; `frame`]"""
    heading: complex
    """e^{iθ}, unit [`frame`]."""
    deviation: float = 0.0
    """Standard deviation of the position, in its worse axis [m]."""
    heading_deviation: float = 0.0
    """[rad]"""
    frame: str = WORLD_FRAME

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        ros.write_pose(to, self.position, self.heading)
        variance, turn = self.deviation**2, self.heading_deviation**2
        to.doubles(variance)
        to.zeros(6)
        to.doubles(variance)
        to.zeros(27)
        to.doubles(turn)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        position, heading = ros.read_pose(source)
        (x,) = source.doubles(1)
        source.skip(6)
        (y,) = source.doubles(1)
        source.skip(27)
        variances = x, y, *source.doubles(1)
        if not all(0.0 <= one < math.inf for one in variances):
            raise BadMessage(f"variances are {variances}, must be finite and not negative")
        x, y, turn = (math.sqrt(one) for one in variances)
        return cls(stamp, position, heading, max(x, y), turn, frame)


class Transform(NamedTuple):
    """geometry_msgs/TransformStamped: the frame `child` in the frame `parent`."""

    stamp: float
    """[s, sender's system clock]"""
    parent: str
    child: str
    position: complex
    """[m]"""
    heading: complex
    """Unit."""


@dataclass(frozen=True, slots=True)
class Transforms(Message):
    """tf2_msgs/TFMessage: those of its transforms that turn about z only; others are skipped."""

    ROS_TYPE: ClassVar[str] = "tf2_msgs/msg/TFMessage"
    DEFINITION: ClassVar[str] = "geometry_msgs/TransformStamped[] transforms\n"
    TYPE_HASH: ClassVar[str] = "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    transforms: tuple[Transform, ...]

    def _write(self, to: Writer) -> None:
        to.count(len(self.transforms))
        for one in self.transforms:
            ros.write_header(to, one.stamp, one.parent)
            ros.write_text(to, one.child)
            ros.write_pose(to, one.position, one.heading)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        found = []
        for _ in range(source.count()):
            stamp, parent = ros.read_header(source)
            child = ros.read_text(source)
            x, y, z, *orientation = source.doubles(7)
            with suppress(BadMessage):  # a wheel, or a sensor on its side
                heading = ros.heading_of(*orientation)
                ros.within("position", ros.MAX_POSITION, x, y, z)
                found.append(Transform(stamp, parent, child, complex(x, y), heading))
        return cls(tuple(found))


@dataclass(frozen=True, slots=True)
class Displacement(Message):
    """geometry_msgs/PointStamped: from a robot's control point to another's [m; body frame]."""

    ROS_TYPE: ClassVar[str] = "geometry_msgs/msg/PointStamped"
    DEFINITION: ClassVar[str] = "std_msgs/Header header\ngeometry_msgs/Point point\n"
    TYPE_HASH: ClassVar[str] = "4c0296af86e01e562e9e0405d138a01537247580076c58ea38d7923ac1045897"
    stamp: float
    displacement: complex
    frame: str = "base_footprint"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        x, y = self.displacement.real, self.displacement.imag
        ros.within("displacement", ros.MAX_POSITION, x, y)
        to.doubles(x, y, 0.0)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        x, y, z = source.doubles(3)
        ros.within("displacement", ros.MAX_POSITION, x, y, z)
        return cls(stamp, complex(x, y), frame)


@dataclass(frozen=True, slots=True)
class Number(Message):
    """std_msgs/Float64, finite."""

    ROS_TYPE: ClassVar[str] = "std_msgs/msg/Float64"
    DEFINITION: ClassVar[str] = "float64 data\n"
    TYPE_HASH: ClassVar[str] = "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a"
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
class Text(Message):
    """std_msgs/String, printable."""

    ROS_TYPE: ClassVar[str] = "std_msgs/msg/String"
    DEFINITION: ClassVar[str] = "string data\n"
    TYPE_HASH: ClassVar[str] = "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    text: str

    def _write(self, to: Writer) -> None:
        ros.write_text(to, self.text)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        return cls(ros.read_text(source))


M = TypeVar("M", bound=Message)


def encode(message: Message) -> bytes:
    """Encode as CDR, little endian. Raises BadMessage for a message that no receiver would accept."""
    to = Writer()
    message._write(to)  # noqa: SLF001 - the two halves of one codec
    payload = to.written()
    if len(payload) > message.MAX_BYTES:
        raise BadMessage(f"{message.ROS_TYPE}: {len(payload)} bytes, at most {message.MAX_BYTES} may be sent")
    return payload


def decode(cls: type[M], payload: bytes) -> M:
    """Decode a `cls` from CDR of either byte order. Raises BadMessage, nothing else, if it is invalid."""
    try:
        if len(payload) > cls.MAX_BYTES:
            raise BadMessage(f"{len(payload)} bytes, at most {cls.MAX_BYTES} are read")
        source = Reader(payload)
        message = cls._read(source)
        source.end()
    except BadMessage as error:
        raise BadMessage(f"{cls.ROS_TYPE}: {error}") from None
    return message
