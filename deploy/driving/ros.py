"""ROS topics at the driver's machine, through its bridge or router."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager

from formation.deploy.refusal import Refusal
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig
from formation.transport.runtime.flags import ros_domain

MAX_WAITING = 64
"""Most messages that wait to be read: of more the oldest are lost, as only the newest count."""
TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
"""Names of ROS topics."""
ROUTER = "tcp/127.0.0.1:7447"
"""Where zenoh-bridge-ros2dds and rmw_zenohd listen."""


def add_router(options: argparse.ArgumentParser) -> None:
    """Add the flags that name the bridge or router, and the ROS domain."""
    options.add_argument(
        "--domain",
        type=ros_domain,
        metavar="ID",
        help="ROS domain of the topics with rmw_zenoh (default: ROS_DOMAIN_ID, or 0)",
    )
    options.add_argument(
        "--ros",
        metavar="ENDPOINT",
        help=f"the ROS 2 bridge or router of this machine, which topics need (default {ROUTER})",
    )


def topic(text: str) -> str:
    """Parse the name of a topic on the command line. Raises ArgumentTypeError."""
    if not TOPIC.fullmatch(text):
        raise argparse.ArgumentTypeError(
            f"{text!r}: must be words of letters, digits and _, joined by /, such as /goal_pose"
        )
    return text


def router(options: argparse.Namespace) -> tuple[str, int]:
    """Return the endpoint of the bridge or router, and the ROS domain. Raises Refusal."""
    if options.domain is not None:
        return options.ros or ROUTER, options.domain
    try:
        return options.ros or ROUTER, ros_domain(os.environ.get("ROS_DOMAIN_ID") or "0")
    except argparse.ArgumentTypeError as error:
        raise Refusal(f"ROS_DOMAIN_ID {error}") from None


@contextmanager
def listening(endpoint: str, domain: int, topics: tuple[str, ...]) -> Iterator[Bus]:
    """Yield a bus that receives `topics` under their own names, from a bridge or from rmw_zenoh.

    rmw_zenoh puts the `domain` before a topic, type and hash after it. A robot's topic of the same name has
    the robot's name in that place. Raises BusError.
    """
    config = BusConfig(connect=(endpoint,), mode="client", name="driver", connect_flag="--ros")
    with Bus(config, capacity=MAX_WAITING) as bus:
        for topic in topics:
            key = topic.strip("/")
            bus.subscribe(key)
            bus.subscribe(f"{domain}/{key}/*/*", key)
        yield bus
