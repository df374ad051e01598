"""Fixtures for tests of buses: an endpoint, a linked pair, each ROS 2 transport, names, an exit stack."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from formation.topics import ODOM
from formation.transport.bus import Bus, BusConfig
from tests.processes.agent.robot_sides import mission_of
from tests.support.bus_tools import ODOMETRY
from tests.support.child import free_endpoint, until

TRANSPORTS: tuple[Ros, ...] = ("ros2dds", "rmw_zenoh")


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture(params=TRANSPORTS)
def ros(request: pytest.FixtureRequest) -> Ros:
    transport: Ros = request.param
    return transport


@pytest.fixture
def naming(ros: Ros) -> Naming:
    return Naming.of(mission_of(ros).robots, ["robot2"])


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def pair(endpoint: str) -> Iterator[tuple[Bus, Bus]]:
    """A bus that listens and subscribes, and one that dials it, is linked and has advertised."""
    with Bus(BusConfig(listen=(endpoint,))) as here, Bus(BusConfig(connect=(endpoint,))) as there:
        here.subscribe(ODOMETRY)
        there.advertise(ODOM, ODOMETRY)
        until(lambda: there.watched(ODOMETRY))
        yield here, there
