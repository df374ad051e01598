"""Fixtures for tests of the robot's bus: an endpoint, each ROS 2 transport, names, an exit stack."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from tests.processes.agent.robot_sides import mission_of
from tests.support.child import free_endpoint

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
