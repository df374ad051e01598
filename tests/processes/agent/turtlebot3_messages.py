"""ROS 2 messages of a TurtleBot3, encoded by pycdr2, a library that this project does not use."""

# No postponed annotations here: pycdr2 reads the fields' types when it creates a class.
import math
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pycdr2 import IdlStruct
from pycdr2.types import array, float64, int32, uint32

if TYPE_CHECKING:
    Covariance = list[float]
else:
    Covariance = array[float64, 36]
_ONE_AT_A_TIME = threading.Lock()


@dataclass
class Time(IdlStruct):
    """builtin_interfaces/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct):
    """std_msgs/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct):
    """geometry_msgs/Vector3, and geometry_msgs/Point."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct):
    """geometry_msgs/Quaternion."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct):
    """geometry_msgs/Pose."""

    position: Vector3
    orientation: Quaternion


@dataclass
class Twist(IdlStruct):
    """geometry_msgs/Twist."""

    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct):
    """geometry_msgs/TwistStamped."""

    header: Header
    twist: Twist


@dataclass
class PoseStamped(IdlStruct):
    """geometry_msgs/PoseStamped."""

    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance(IdlStruct):
    """geometry_msgs/PoseWithCovariance."""

    pose: Pose
    covariance: Covariance = field(default_factory=lambda: [0.0] * 36)


@dataclass
class TwistWithCovariance(IdlStruct):
    """geometry_msgs/TwistWithCovariance."""

    twist: Twist
    covariance: Covariance = field(default_factory=lambda: [0.0] * 36)


@dataclass
class Odometry(IdlStruct):
    """nav_msgs/Odometry."""

    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


def twist(speed: float, turn_rate: float) -> Twist:
    """Return a planar twist [m/s; rad/s]."""
    return Twist(Vector3(x=speed), Vector3(z=turn_rate))


def stamped(wall: float, frame: str) -> Header:
    """Return a header of time `wall` [s since the epoch]."""
    seconds, rest = divmod(wall, 1.0)
    return Header(Time(int(seconds), int(rest * 1e9)), frame)


def odometry(
    wall: float, position: complex, heading: complex, moving: Twist, frames: tuple[str, str]
) -> bytes:
    """Return nav_msgs/Odometry with zero covariances in CDR; `heading` e^{iθ}, `frames` of pose and twist."""
    half = math.atan2(heading.imag, heading.real) / 2.0
    pose = Pose(
        Vector3(position.real, position.imag, 0.0), Quaternion(0.0, 0.0, math.sin(half), math.cos(half))
    )
    message = Odometry(
        stamped(wall, frames[0]), frames[1], PoseWithCovariance(pose), TwistWithCovariance(moving)
    )
    return encoded(message)


def encoded(message: IdlStruct) -> bytes:
    """Return the message in CDR. The lock: a type of pycdr2 has one buffer, which threads would share."""
    with _ONE_AT_A_TIME:
        return bytes(message.serialize())
