"""What ROS 2's message types are made of, for recordings and for who shows them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from types import MappingProxyType

DEFINITIONS = MappingProxyType(
    {
        "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
        "diagnostic_msgs/DiagnosticArray": (
            "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
        ),
        "diagnostic_msgs/DiagnosticStatus": (
            "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
            "byte level\nstring name\nstring message\nstring hardware_id\n"
            "diagnostic_msgs/KeyValue[] values\n"
        ),
        "diagnostic_msgs/KeyValue": "string key\nstring value\n",
        "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
        "geometry_msgs/PointStamped": "std_msgs/Header header\ngeometry_msgs/Point point\n",
        "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
        "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
        "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
        "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist\n",
        "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
        "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
        "nav_msgs/Odometry": (
            "std_msgs/Header header\nstring child_frame_id\n"
            "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n"
        ),
        "rcl_interfaces/Log": (
            "uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\n"
            "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
            "string file\nstring function\nuint32 line\n"
        ),
        "sensor_msgs/LaserScan": (
            "std_msgs/Header header\n"
            "float32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n"
            "float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\n"
            "float32[] ranges\nfloat32[] intensities\n"
        ),
        "std_msgs/Float64": "float64 data\n",
        "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
        "std_msgs/String": "string data\n",
    }
)
"""Fields and constants in ROS 2 Jazzy, of every type of the topic table and of what these contain."""
BETWEEN = "=" * 80
"""A line between one type and the next."""


@cache
def definition(ros_type: str) -> str:
    """The type with all it contains, as MCAP's ``ros2msg`` schemas want it. KeyError for an unknown type."""
    package, _, name = ros_type.partition("/msg/")
    whole = f"{package}/{name}"
    if whole not in DEFINITIONS:
        raise KeyError(f"{ros_type!r} is no ROS 2 type known here; one would be 'nav_msgs/msg/Odometry'")
    first, *others = dict.fromkeys(_within(whole))  # each once, where it is met first
    return DEFINITIONS[first] + "".join(f"{BETWEEN}\nMSG: {one}\n{DEFINITIONS[one]}" for one in others)


def _within(ros_type: str) -> Iterator[str]:
    """The type and, after each other, those of its fields, with what these contain."""
    yield ros_type
    for field in DEFINITIONS[ros_type].splitlines():
        of = field.split()[0].removesuffix("[]")
        if "/" in of:
            yield from _within(of)
