"""What tests of the robot's side share: an endpoint, each spelling of ROS 2, a place to keep things open."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from tests.processes.agent.robot_sides import mission_of
from tests.support.child import free_endpoint

SPELLINGS: tuple[Ros, ...] = ("ros2dds", "rmw_zenoh")


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture(params=SPELLINGS)
def ros(request: pytest.FixtureRequest) -> Ros:
    spelling: Ros = request.param
    return spelling


@pytest.fixture
def naming(ros: Ros) -> Naming:
    return Naming.of(mission_of(ros).robots, ["robot2"])


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack
