"""What ROS 2's message types are made of, for recordings and for who shows them: not for a robot.

It is rosbags that knows the definitions, and it takes its time to load.
"""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)


@cache
def definition(ros_type: str) -> str:
    """The type with all it contains, as MCAP's ``ros2msg`` schemas want it. KeyError for an unknown type."""
    if ros_type not in STORE.types:
        raise KeyError(f"{ros_type!r} is no ROS 2 type known here; one would be 'nav_msgs/msg/Odometry'")
    return STORE.generate_msgdef(ros_type, ros_version=2)[0]
