"""Messages written and read by rosbags, an independent implementation to compare ours with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from formation.ros2 import laser_scan, ros
from formation.ros2.cdr import MAX_PADDING_BYTES
from formation.ros2.goal_status import GoalStatus
from formation.ros2.messages import (
    MAX_PAYLOAD_BYTES,
    BadMessage,
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
)

STORE = get_typestore(Stores.ROS2_JAZZY)
ZEROS = np.zeros(36)


def make(name: str, *values: Any) -> Any:
    """Make a message, or a part of one, by the name of its type."""
    return STORE.types[name](*values)


def stamp(seconds: float) -> Any:
    whole = int(seconds)
    rest = round((seconds - whole) * 1e9)
    return make("builtin_interfaces/msg/Time", whole + rest // 10**9, rest % 10**9)


def header(seconds: float, frame: str) -> Any:
    return make("std_msgs/msg/Header", stamp(seconds), frame)


def point(place: complex) -> Any:
    return make("geometry_msgs/msg/Point", place.real, place.imag, 0.0)


def pose(place: complex, heading: complex) -> Any:
    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, *ros.half_turn(heading))
    return make("geometry_msgs/msg/Pose", point(place), turn)


def twist(speed: float, turn_rate: float) -> Any:
    ahead = make("geometry_msgs/msg/Vector3", speed, 0.0, 0.0)
    return make("geometry_msgs/msg/Twist", ahead, make("geometry_msgs/msg/Vector3", 0, 0, turn_rate))


def status(one: Status) -> Any:
    pairs = [make("diagnostic_msgs/msg/KeyValue", *pair) for pair in one.values.items()]
    texts = (one.name, one.message, one.hardware_id)
    return make("diagnostic_msgs/msg/DiagnosticStatus", one.level, *texts, pairs)


def goal(one: bytes, status: int) -> Any:
    number = make("unique_identifier_msgs/msg/UUID", np.frombuffer(one, np.uint8))
    return make("action_msgs/msg/GoalStatus", make("action_msgs/msg/GoalInfo", number, stamp(0.0)), status)


FIELDS: Mapping[type, Callable[[Any], tuple[Any, ...]]] = {
    Odometry: lambda m: (
        header(m.stamp, m.frame),
        m.child_frame,
        make("geometry_msgs/msg/PoseWithCovariance", pose(m.position, m.heading), ZEROS),
        make("geometry_msgs/msg/TwistWithCovariance", twist(m.speed, m.turn_rate), ZEROS),
    ),
    Twist: lambda m: (twist(m.speed, m.turn_rate).linear, twist(m.speed, m.turn_rate).angular),
    TwistStamped: lambda m: (header(m.stamp, m.frame), twist(m.speed, m.turn_rate)),
    Pose: lambda m: (header(m.stamp, m.frame), pose(m.position, m.heading)),
    Displacement: lambda m: (header(m.stamp, m.frame), point(m.displacement)),
    Number: lambda m: (m.value,),
    Diagnostics: lambda m: (header(m.stamp, ""), [status(one) for one in m.statuses]),
    LogEntry: lambda m: (stamp(m.stamp), m.level, m.name, m.text, "", m.kind, 0),
    Text: lambda m: (m.text,),
    GoalStatuses: lambda m: ([goal(*one) for one in m.statuses],),
    LaserScan: lambda m: (
        header(m.stamp, m.frame),
        m.angle_min,
        m.angle_min + m.angle_increment * (len(m.ranges) - 1),
        *attrgetter("angle_increment", "time_increment", "scan_time", "range_min", "range_max")(m),
        np.array(m.ranges, np.float32),
        np.array([], np.float32),
    ),
}
"""Arguments of the rosbags type for each class."""


def written(message: Message, *, little_endian: bool = True) -> bytes:
    raw = make(message.ROS_TYPE, *FIELDS[type(message)](message))
    return bytes(STORE.serialize_cdr(raw, message.ROS_TYPE, little_endian=little_endian))


def read(cls: type[Any], payload: bytes) -> tuple[Any, ...] | None:
    """Return the fields of the message in `payload`, as numbers and texts; None if rosbags refuses it.

    None, too, for payloads that our decoder refuses before it reads fields.
    """
    if len(payload) > MAX_PAYLOAD_BYTES or len(payload) <= 4 or payload[2] or payload[3] > MAX_PADDING_BYTES:
        return None
    try:
        raw = STORE.deserialize_cdr(payload, cls.ROS_TYPE)
        return READ[cls](raw)
    except (SerdeError, BadMessage):
        return None


def _stamp(raw: Any) -> float:
    if not 0 <= raw.sec < 2**31 - 1 or raw.nanosec >= 10**9:
        raise BadMessage("stamp")
    return float(raw.sec + raw.nanosec * 1e-9)


def _text(raw: str) -> str:
    if not raw.isprintable():
        raise BadMessage("text")
    return raw


def _headed(raw: Any, *values: Any) -> tuple[Any, ...]:
    """Return the header's stamp, `values`, and the header's frame."""
    return _stamp(raw.header.stamp), *values, _text(raw.header.frame_id)


def _point(raw: Any) -> complex:
    ros.within("", ros.MAX_POSITION, raw.x, raw.y, raw.z)
    return complex(raw.x, raw.y)


def _pose(raw: Any) -> tuple[complex, complex]:
    return _point(raw.position), ros.heading_of(*attrgetter("x", "y", "z", "w")(raw.orientation))


def _twist(raw: Any) -> tuple[float, float]:
    for vector in (raw.linear, raw.angular):
        ros.within("", ros.MAX_SPEED, vector.x, vector.y, vector.z)
    return raw.linear.x, raw.angular.z


def _level(level: int, legal: tuple[int, ...]) -> int:
    if level not in legal:
        raise BadMessage("level")
    return level


def _status(raw: Any) -> Status:
    values = {_text(pair.key): _text(pair.value) for pair in raw.values}
    name, message, hardware_id = map(_text, (raw.name, raw.message, raw.hardware_id))
    return Status(name, _level(raw.level, (0, 1, 2, 3)), message, hardware_id, values)


def _scan(raw: Any) -> tuple[Any, ...]:
    beams, increment = len(raw.ranges), abs(raw.angle_increment)
    ros.within("", laser_scan.MAX_ANGLE, raw.angle_min, raw.angle_max, raw.angle_increment)
    legal = (
        0.0 <= raw.range_min < raw.range_max <= laser_scan.MAX_RANGE
        and all(0.0 <= time <= laser_scan.MAX_TIME for time in (raw.time_increment, raw.scan_time))
        and 1 <= beams <= laser_scan.MAX_BEAMS
        and len(raw.intensities) in {0, beams}
        and increment >= laser_scan.MIN_BEAM_ANGLE
        and (beams - 1) * increment <= laser_scan.MAX_SWEEP_ANGLE
    )
    if not legal:
        raise BadMessage("scan")
    ranges = np.where(np.isnan(raw.ranges), np.inf, raw.ranges)
    return (
        _stamp(raw.header.stamp),
        *(raw.angle_min, raw.angle_increment, raw.range_min, raw.range_max),
        tuple(float(distance) for distance in ranges),
        *(raw.time_increment, raw.scan_time),
        _text(raw.header.frame_id),
        bool(np.isnan(raw.ranges).all()),
    )


def _goal(raw: Any) -> tuple[bytes, int]:
    _stamp(raw.goal_info.stamp)
    return bytes(raw.goal_info.goal_id.uuid), GoalStatus(_level(raw.status, tuple(GoalStatus)))


def _number(raw: Any) -> float:
    ros.within("", 1.797_693_134_862_315_7e308, raw.data)
    return float(raw.data)


READ: Mapping[type, Callable[[Any], tuple[Any, ...]]] = {
    Odometry: lambda raw: (
        *_headed(raw, *_pose(raw.pose.pose), *_twist(raw.twist.twist)),
        _text(raw.child_frame_id),
    ),
    Twist: _twist,
    TwistStamped: lambda raw: _headed(raw, *_twist(raw.twist)),
    Pose: lambda raw: _headed(raw, *_pose(raw.pose)),
    Displacement: lambda raw: _headed(raw, _point(raw.point)),
    Number: lambda raw: (_number(raw),),
    Diagnostics: lambda raw: (_headed(raw)[0], tuple(map(_status, raw.status))),
    LogEntry: lambda raw: (
        _stamp(raw.stamp),
        _level(raw.level, (10, 20, 30, 40, 50)),
        *map(_text, (raw.name, raw.msg, raw.function)),
    ),
    Text: lambda raw: (_text(raw.data),),
    GoalStatuses: lambda raw: (tuple(map(_goal, raw.status_list)),),
    LaserScan: _scan,
}
"""The fields of each class, in order."""
