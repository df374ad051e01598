"""The parts of ROS 2 messages, spelled for a planar robot, with the limits that both directions keep.

``to_*`` builds a part, ``from_*`` reads it; both raise BadMessage for what is not finite, not physical or not
planar.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as RosTime
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Point as RosPoint
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Pose as RosPose
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseWithCovariance as RosPoseWithCovariance
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Quaternion as RosQuaternion
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Twist as RosTwist
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__TwistWithCovariance as RosTwistWithCovariance,
)
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as RosVector3
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as RosHeader

from formation.wire import BadMessage

MAX_POSITION = 1e6
"""[m]"""
MAX_SPEED = 1e3
"""[m/s] and [rad/s]"""
MAX_TILT = 0.2
"""Roll and pitch together [rad]: beyond it a planar heading means nothing."""
_MAX_TILT = math.sin(MAX_TILT / 2.0) ** 2
UNIT_TOLERANCE = 0.01
"""How far the length of a heading or a quaternion may be from 1."""

STORE = get_typestore(Stores.ROS2_JAZZY)
_NO_COVARIANCE = np.zeros(36)  # what the TurtleBot3 sends


def within(what: str, limit: float, *numbers: float) -> None:
    """Refuse numbers that are not finite or beyond ±`limit`."""
    for number in numbers:
        if not -limit <= number <= limit:
            raise BadMessage(f"{what} is {number:g}, must be a number within ±{limit:g}")


def to_text(text: str) -> str:
    """`text`, with a space for each character that cannot be encoded or would upset a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else " " for c in text)


def from_text(text: str) -> str:
    """`text`, if a terminal can show it."""
    if not text.isprintable():
        raise BadMessage(f"text has a control character: {text[:40]!r}")
    return text


def to_header(stamp: float, frame: str) -> RosHeader:
    """std_msgs/Header; `stamp` [s since the epoch]."""
    if not 0.0 <= stamp < 2**31:
        raise BadMessage(f"stamp is {stamp:g} s, must be from 0 to 2^31 s")
    seconds = int(stamp)
    nanoseconds = round((stamp - seconds) * 1e9)
    if nanoseconds == 1_000_000_000:
        seconds, nanoseconds = seconds + 1, 0
    return RosHeader(RosTime(seconds, nanoseconds), to_text(frame))


def from_header(header: RosHeader) -> tuple[float, str]:
    """Stamp [s] and frame."""
    return from_stamp(header.stamp), from_text(header.frame_id)


def from_stamp(stamp: RosTime) -> float:
    """builtin_interfaces/Time [s since the epoch]."""
    seconds, nanoseconds = stamp.sec, stamp.nanosec
    if not 0 <= seconds < 2**31 - 1 or nanoseconds >= 1_000_000_000:
        raise BadMessage(f"stamp is {seconds} s and {nanoseconds} ns, must be from 0 to 2^31 s and under 1 s")
    return seconds + nanoseconds * 1e-9


def to_point(what: str, point: complex) -> RosPoint:
    """geometry_msgs/Point [m]."""
    within(what, MAX_POSITION, point.real, point.imag)
    return RosPoint(point.real, point.imag, 0.0)


def from_point(what: str, point: RosPoint) -> complex:
    """The point's shadow on the plane [m]."""
    within(what, MAX_POSITION, point.x, point.y, point.z)
    return complex(point.x, point.y)


def to_pose(position: complex, heading: complex) -> RosPose:
    """geometry_msgs/Pose: `heading` e^{iθ} becomes a turn by θ about z (half angle without trigonometry)."""
    length = abs(heading)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise BadMessage(f"heading has length {length:g}, must be 1")
    cosine, sine = heading.real / length, heading.imag / length
    if cosine >= 0.0:
        w = math.sqrt((1.0 + cosine) / 2.0)
        z = sine / (2.0 * w)
    else:  # from z, which is then the larger of the two
        z = math.copysign(math.sqrt((1.0 - cosine) / 2.0), sine)
        w = sine / (2.0 * z)
    return RosPose(to_point("position", position), RosQuaternion(0.0, 0.0, z, w))


def from_pose(pose: RosPose) -> tuple[complex, complex]:
    """Position [m] and heading e^{iθ}, unit."""
    q = pose.orientation
    heading = heading_of(q.x, q.y, q.z, q.w)
    return from_point("position", pose.position), heading


def heading_of(x: float, y: float, z: float, w: float) -> complex:
    """e^{iθ}, unit, of a geometry_msgs/Quaternion that turns about z, or nearly so."""
    tilt = x * x + y * y  # sin² of half the angle between the robot's z axis and the world's
    norm = tilt + z * z + w * w
    if not abs(norm - 1.0) <= 2.0 * UNIT_TOLERANCE:
        raise BadMessage(f"orientation has length {math.sqrt(norm):g}, must be 1")
    if tilt > _MAX_TILT:
        angle = 2.0 * math.asin(min(1.0, math.sqrt(tilt)))
        raise BadMessage(f"robot is tilted by {angle:.2f} rad, must be at most {MAX_TILT}")
    heading = complex(norm - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y))
    return heading / abs(heading)


def to_twist(speed: float, turn_rate: float) -> RosTwist:
    """geometry_msgs/Twist [m/s; rad/s]."""
    within("speed", MAX_SPEED, speed)
    within("turn rate", MAX_SPEED, turn_rate)
    return RosTwist(RosVector3(speed, 0.0, 0.0), RosVector3(0.0, 0.0, turn_rate))


def from_twist(twist: RosTwist) -> tuple[float, float]:
    """Forward speed [m/s] and turn rate [rad/s]; of the other components only that they are physical."""
    linear, angular = twist.linear, twist.angular
    within("speed", MAX_SPEED, linear.x, linear.y, linear.z)
    within("turn rate", MAX_SPEED, angular.z, angular.x, angular.y)
    return linear.x, angular.z


def without_covariance(
    pose: RosPose, twist: RosTwist
) -> tuple[RosPoseWithCovariance, RosTwistWithCovariance]:
    """The two halves of an odometry."""
    return RosPoseWithCovariance(pose, _NO_COVARIANCE), RosTwistWithCovariance(twist, _NO_COVARIANCE)


@cache
def definition(ros_type: str) -> str:
    """The type with all it contains, as MCAP's ``ros2msg`` schemas want it. KeyError for an unknown type."""
    _must_know(ros_type)
    return STORE.generate_msgdef(ros_type, ros_version=2)[0]


@cache
def type_hash(ros_type: str) -> str:
    """The type's ``RIHS01_…`` hash, as rmw_zenoh writes it into keys. KeyError for an unknown type."""
    _must_know(ros_type)
    return STORE.hash_rihs01(ros_type)


def _must_know(ros_type: str) -> None:
    if ros_type not in STORE.types:
        raise KeyError(f"{ros_type!r} is no ROS 2 type known here; one would be 'nav_msgs/msg/Odometry'")
