"""The hashes of ROS 2 Jazzy's message types, as rmw_zenoh writes them into keys."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

TYPE_HASHES: Mapping[str, str] = MappingProxyType(
    {
        "diagnostic_msgs/msg/DiagnosticArray": (
            "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
        ),
        "geometry_msgs/msg/PointStamped": "4c0296af86e01e562e9e0405d138a01537247580076c58ea38d7923ac1045897",
        "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
        "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
        "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
        "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
        "rcl_interfaces/msg/Log": "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
        "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
        "std_msgs/msg/Float64": "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
        "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    }
)
"""RIHS01 of every type of the topic table."""


def type_hash(ros_type: str) -> str:
    """The type's ``RIHS01_…`` hash. KeyError for a type that is not in the topic table."""
    if ros_type not in TYPE_HASHES:
        raise KeyError(f"{ros_type!r} is no ROS 2 type known here; one would be 'nav_msgs/msg/Odometry'")
    return f"RIHS01_{TYPE_HASHES[ros_type]}"
