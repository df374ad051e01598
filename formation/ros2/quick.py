"""The usual form of the usual messages, read without a detour.

What is read thousands of times a second is nearly always spelled the same: little endian, exactly as long as
its fields take, every number within its limits. Such a message is read here, by `struct`; of any other these
functions say nothing (None), and the full reader decides whether and why it is bad. So what is read here is
what the full reader would read, bit by bit, in a fifth of its time, and what is refused is refused there.

Each returns the fields of the message of its name, in order.
"""

from __future__ import annotations

import struct
from functools import lru_cache

from formation.ros2 import ros
from formation.wire import BadMessage

LONGEST = 1024
"""Of a message with a fixed number of fields [bytes]; only its frames' names could make it longer."""
MOST = 256
"""Statuses, and values of each, in diagnostics."""
_LITTLE = b"\0\1\0\0"
_HEADER, _COUNT = struct.Struct("<iII"), struct.Struct("<I")
_POSE, _TWIST = struct.Struct("<7d"), struct.Struct("<6d")
_COVARIANCE = 36 * 8

Odometry = tuple[float, complex, complex, float, float, str, str]
Pose = tuple[float, complex, complex, str]
Twist = tuple[float, float]
TwistStamped = tuple[float, float, float, str]


def odometry(data: bytes) -> Odometry | None:
    """nav_msgs/Odometry."""
    header = _header(data)
    if header is None:
        return None
    stamp, frame, end = header
    at = (end + 3) & ~3  # offsets are counted from after the encoding's four bytes, as alignment is
    if at + 8 > len(data):
        return None
    (size,) = _COUNT.unpack_from(data, at + 4)
    end = at + 4 + size
    start = 4 + ((end + 7) & ~7)
    if len(data) != start + _POSE.size + _TWIST.size + 2 * _COVARIANCE:
        return None
    child = _text(data[at + 8 : end + 4])
    pose, twist = _pose(data, start), _twist(data, start + _POSE.size + _COVARIANCE)
    return None if child is None or pose is None or twist is None else (stamp, *pose, *twist, frame, child)


def pose(data: bytes) -> Pose | None:
    """geometry_msgs/PoseStamped."""
    header = _header(data)
    if header is None:
        return None
    stamp, frame, end = header
    start = 4 + ((end + 7) & ~7)
    if len(data) != start + _POSE.size:
        return None
    found = _pose(data, start)
    return None if found is None else (stamp, *found, frame)


def twist(data: bytes) -> Twist | None:
    """geometry_msgs/Twist."""
    return _twist(data, 4) if len(data) == 4 + _TWIST.size and data[:4] == _LITTLE else None


def twist_stamped(data: bytes) -> TwistStamped | None:
    """geometry_msgs/TwistStamped."""
    header = _header(data)
    if header is None:
        return None
    stamp, frame, end = header
    start = 4 + ((end + 7) & ~7)
    if len(data) != start + _TWIST.size:
        return None
    found = _twist(data, start)
    return None if found is None else (stamp, *found, frame)


def _header(data: bytes) -> tuple[float, str, int] | None:
    """Stamp [s], frame, and where it ends."""
    if not 16 < len(data) <= LONGEST or data[:4] != _LITTLE:
        return None
    seconds, nanoseconds, size = _HEADER.unpack_from(data, 4)
    frame = _text(data[16 : 16 + size])
    if frame is None or len(data) < 16 + size or not 0 <= seconds < 2**31 - 1 or nanoseconds >= 10**9:
        return None
    return seconds + nanoseconds * 1e-9, frame, 12 + size


@lru_cache(maxsize=512)
def _text(data: bytes) -> str | None:
    """A string with its zero at the end."""
    if not data or data[-1]:
        return None
    try:
        text = data[:-1].decode()
    except UnicodeDecodeError:
        return None
    return text if text.isprintable() else None


def _pose(data: bytes, at: int) -> tuple[complex, complex] | None:
    """Position [m] and heading."""
    x, y, z, *orientation = _POSE.unpack_from(data, at)
    most = ros.MAX_POSITION
    if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
        return None
    try:
        return complex(x, y), ros.heading_of(*orientation)
    except BadMessage:
        return None


def _twist(data: bytes, at: int) -> tuple[float, float] | None:
    """Forward speed [m/s] and turn rate [rad/s]."""
    numbers = _TWIST.unpack_from(data, at)
    for number in numbers:
        if not -ros.MAX_SPEED <= number <= ros.MAX_SPEED:
            return None
    return numbers[0], numbers[5]
