"""The points of a goal or a path of ROS."""

from __future__ import annotations

import cmath
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.deploy.driving.follow import route
from formation.deploy.driving.waypoints import MAX_WAYPOINTS, thinned, waypoints
from formation.mission.file import load
from formation.ros2.messages import Path, Pose, encode
from formation.wire import BadMessage, Sample

CONVOY = load("convoy")


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


def test_longest_path_keeps_corners_within_tolerance() -> None:
    side = [0.025 * number for number in range(4000)]
    points = (*(complex(x, 0.0) for x in side), *(complex(side[-1], y) for y in side))
    found = waypoints(Sample("plan", encode(Path(1.0, points)), None, 0.0), "/plan")
    assert found == [points[0], points[4000], points[-1]]


def test_path_that_winds_too_much_is_refused() -> None:
    """As a straight line through its ends, it would pass through obstacles."""
    points = tuple(complex(0.02 * number, 0.5 * (number % 2)) for number in range(1000))
    with pytest.raises(BadMessage, match="winds too much: with 300 of its 1000 points"):
        waypoints(Sample("plan", encode(Path(1.0, points)), None, 0.0), "/plan")


@given(
    st.lists(st.complex_numbers(max_magnitude=50.0), min_size=1, max_size=40), st.sampled_from([0.01, 1.0])
)
def test_thinned_path_stays_within_tolerance(points: list[complex], tolerance: float) -> None:
    left = thinned(points, tolerance)
    assert (left[0], left[-1]) == (points[0], points[-1])
    for point in points:
        gaps = [_distance(point, a, b) for a, b in pairwise(left)] or [abs(point - left[0])]
        assert min(gaps) <= tolerance + 1e-6


def _distance(point: complex, a: complex, b: complex) -> float:
    size = abs(b - a)
    part = 0.0 if size == 0.0 else ((point - a) * ((b - a) / size).conjugate()).real / size
    return abs(point - a - min(max(part, 0.0), 1.0) * (b - a))


def test_path_with_poses_of_another_frame_is_refused() -> None:
    payload = encode(Path(1.0, (0j, 1.0 + 0j), frame="lap"))
    with pytest.raises(BadMessage, match="pose 1 is in frame lap, the path in frame map"):
        waypoints(Sample("plan", payload.replace(b"lap", b"map", 1), None, 0.0), "/plan")
