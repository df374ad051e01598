"""Definitions and hashes of the message types, for recordings, keys and the programs that show them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from types import MappingProxyType

from formation.ros2.messages import Odometry
from formation.ros2.ros import BY_TYPE, Message

NESTED = MappingProxyType(
    {
        "action_msgs/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n",
        "action_msgs/GoalStatus": (
            "int8 STATUS_UNKNOWN=0\nint8 STATUS_ACCEPTED=1\nint8 STATUS_EXECUTING=2\n"
            "int8 STATUS_CANCELING=3\nint8 STATUS_SUCCEEDED=4\nint8 STATUS_CANCELED=5\n"
            "int8 STATUS_ABORTED=6\naction_msgs/GoalInfo goal_info\nint8 status\n"
        ),
        "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
        "diagnostic_msgs/DiagnosticStatus": (
            "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\n"
            "string message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
        ),
        "diagnostic_msgs/KeyValue": "string key\nstring value\n",
        "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
        "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
        "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        "geometry_msgs/TransformStamped": (
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        ),
        "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
        "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
        "unique_identifier_msgs/UUID": "uint8[16] uuid\n",
        "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    }
)
"""Fields and constants in ROS 2 Jazzy of the types that occur only within messages."""
BETWEEN = "=" * 80
"""A line between one type and the next."""


@cache
def definition(ros_type: str) -> str:
    """The type with its nested types, as MCAP's ``ros2msg`` schemas need it. KeyError for an unknown type."""
    whole = _message_class(ros_type).DEFINITION
    others = dict.fromkeys(_within(whole))  # each once, at its first occurrence
    return whole + "".join(f"{BETWEEN}\nMSG: {one}\n{_fields(one)}" for one in others)


def type_hash(ros_type: str) -> str:
    """The type's ``RIHS01_…`` hash. KeyError for an unknown type."""
    return f"RIHS01_{_message_class(ros_type).TYPE_HASH}"


def _message_class(ros_type: str) -> type[Message]:
    """The class of a ROS 2 type. KeyError for an unknown type."""
    if ros_type not in BY_TYPE:
        one = Odometry.ROS_TYPE
        raise KeyError(f"{ros_type!r} is no ROS 2 type known here; one would be {one!r}")
    return BY_TYPE[ros_type]


def _fields(nested: str) -> str:
    """The definition of a field's type, ``package/Name``."""
    return NESTED[nested] if nested in NESTED else _message_class(nested.replace("/", "/msg/")).DEFINITION


def _within(fields: str) -> Iterator[str]:
    """The types of the fields, in sequence, each with its nested types."""
    for line in fields.splitlines():
        of = line.split()[0].removesuffix("[]").partition("[")[0]
        if "/" in of:
            yield of
            yield from _within(_fields(of))
