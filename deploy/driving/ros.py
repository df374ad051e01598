"""ROS topics at the driver's machine, through its bridge or router."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig

ROUTER = "tcp/127.0.0.1:7447"
"""Where zenoh-bridge-ros2dds and rmw_zenohd listen."""


def add_router(options: argparse.ArgumentParser) -> None:
    """Add the flag that names the bridge or router."""
    options.add_argument(
        "--ros",
        default=ROUTER,
        metavar="ENDPOINT",
        help="the ROS 2 bridge or router of this machine, for topics (default %(default)s)",
    )


@contextmanager
def listening(endpoint: str, topics: tuple[str, ...]) -> Iterator[Bus]:
    """Yield a bus that receives `topics` under their own names, from a bridge or from rmw_zenoh.

    rmw_zenoh puts the domain before a topic, type and hash after it. Raises BusError.
    """
    with Bus(BusConfig(connect=(endpoint,), mode="client", name="driver")) as bus:
        for topic in topics:
            key = topic.strip("/")
            bus.subscribe(key)
            bus.subscribe(f"*/{key}/**", key)
        yield bus
