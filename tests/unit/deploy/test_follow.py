"""`formation follow`: goals and paths of ROS as orders of a route."""

from __future__ import annotations

import cmath

import pytest

from formation.deploy.driving import follow
from formation.deploy.driving.follow import MAX_WAYPOINTS, route, waypoints
from formation.deploy.refusal import Refusal
from formation.mission.file import load
from formation.mission.route import Waypoints
from formation.ros2.messages import Path, Pose, encode
from formation.wire import BadMessage, Sample

CONVOY = load("convoy")


def test_goal_becomes_route_of_one_point() -> None:
    goal = Sample("goal_pose", encode(Pose(1.0, 2.0 + 1.0j, 1j)), None, 0.0)
    request = route(CONVOY, waypoints(goal, "/plan"), 0.1)
    assert (request.do, request.legs) == ("route", (Waypoints(waypoints=((2.0, 1.0),), speed=0.1),))


def test_goal_or_path_in_another_frame_is_refused() -> None:
    goal, path = Pose(1.0, 2.0 + 1.0j, 1j, frame="odom"), Path(1.0, (1.0 + 0j,), frame="base_link")
    for key, message in (("goal_pose", goal), ("plan", path)):
        with pytest.raises(BadMessage, match="must be map"):
            waypoints(Sample(key, encode(message), None, 0.0), "/plan")


def test_long_path_becomes_route_with_limited_waypoints() -> None:
    points = tuple(cmath.rect(2.0, 0.01 * number) for number in range(700))
    found = waypoints(Sample("plan", encode(Path(1.0, points)), None, 0.0), "/plan")
    assert len(found) <= MAX_WAYPOINTS + 1
    assert (found[0], found[-1]) == (points[0], points[-1])
    assert route(CONVOY, found, 0.1).legs is not None


def test_empty_path_and_excessive_speed_are_refused() -> None:
    with pytest.raises(BadMessage, match="no points"):
        waypoints(Sample("plan", encode(Path(1.0, ())), None, 0.0), "/plan")
    with pytest.raises(ValueError, match="max_speed"):
        route(CONVOY, [1.0 + 0.0j], 5.0)


def test_follow_refuses_call_without_goals_or_path() -> None:
    with pytest.raises(Refusal, match="--goals TOPIC"):
        follow.main(["convoy"])
