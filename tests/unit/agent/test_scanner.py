"""An agent's use of range scans that are old, noisy, swept during motion, or missing."""

from __future__ import annotations

import cmath
import math
import random

import pytest

from formation.agent.safety.scanner import MAX_OBSTACLE_DISTANCE, Scanner
from formation.control.pipeline import protected
from formation.control.unicycle import Command
from formation.control.zones import Zone
from formation.ros2.messages import BadMessage
from formation.sensing.scan import Mate, obstacles
from tests.support.examples import slow
from tests.support.fleet import at
from tests.unit.agent.scanned import (
    MARGIN,
    RADIUS,
    Robot,
    Wall,
    distance_to_wall,
    mission,
    post,
    scan,
    scanner_after,
)


@pytest.mark.parametrize("speed", [0.2, 1.5, *slow(0.7, -0.7)])
@pytest.mark.parametrize("odometry", [True, False], ids=["odometry", "commands"])
@pytest.mark.parametrize(
    ("way", "lag"), [(0.1, 0.2), *slow((0.0, 0.0), (0.0, 0.1), (0.0, 0.2), (0.1, 0.0), (0.1, 0.1))]
)
def test_robot_stops_before_obstacles_with_poor_scans(
    speed: float, way: float, odometry: bool, lag: float
) -> None:
    ahead = math.copysign(2.5, speed)
    robot = Robot([(ahead + 0j, 0.1)], [(ahead - 3j, ahead + 3j)], way, odometry=odometry, lag=lag, lost=0.1)
    robot.drive(Command(speed, 0.0), 25.0)
    assert 0.0 < robot.nearest < MARGIN + 0.1


@pytest.mark.parametrize("seed", [*range(2), *slow(*range(2, 12))])
@pytest.mark.parametrize("odometry", [True, False], ids=["odometry", "commands"])
def test_robot_with_random_commands_touches_no_obstacle(seed: int, odometry: bool) -> None:
    rng = random.Random(seed)
    discs = [(cmath.rect(rng.uniform(0.5, 1.8), rng.uniform(0, math.tau)), 0.08) for _ in range(6)]
    walls = [(-2 - 2j, 2 - 2j), (2 - 2j, 2 + 2j), (2 + 2j, -2 + 2j), (-2 + 2j, -2 - 2j)]
    robot = Robot(discs, walls, odometry=odometry, lag=0.2, noise=0.003, relative_noise=0.003)
    for _ in range(25):
        robot.drive(Command(rng.uniform(-0.5, 0.8), rng.uniform(-1.5, 1.5)), rng.uniform(0.1, 1.5))
    assert robot.nearest > 0.0


@pytest.mark.parametrize(
    "walls",
    [[(-1 + 0.25j, 6 + 0.25j)], [(1 - 3j, 1 - 0.3j), (1 + 0.3j, 1 + 3j)]],
    ids=["along a wall", "doorway"],
)
def test_robot_drives_along_wall_and_through_doorway(walls: list[Wall]) -> None:
    robot = Robot(walls=walls, noise=0.002, relative_noise=0.0)
    robot.drive(Command(0.3, 0.0), 10.0)
    assert robot.position.real > 2.5


@pytest.mark.parametrize(
    ("begin", "end", "forward", "backward"),
    [
        (-1 - 1.17j, 1 + 0.83j, False, True),
        (-1 - 0.12j, 1 - 0.12j, False, False),
        (0.12 - 1j, 0.12 + 1j, False, True),
        (-0.12 - 1j, -0.12 + 1j, True, False),
    ],
    ids=["beside, nearer ahead", "beside", "ahead", "behind"],
)
def test_probe_inside_margin_may_only_leave_what_is_nearest(
    begin: complex, end: complex, *, forward: bool, backward: bool
) -> None:
    robot = Robot(walls=[(begin, end)], noise=0.0, relative_noise=0.0)
    assert RADIUS < distance_to_wall(0j, begin, end) < RADIUS + MARGIN
    scanner = robot.scanner
    scanner.process_scan(robot.look(), 0.0, at(0.0))
    strangers, allowed = scanner.strangers(at(0.0), []), []
    for speed in (0.03, -0.03):
        sight = scanner.beside(scanner.sight(strangers, at(0.0)), speed, lambda free: free)
        allowed.append(protected(Command(speed, 0.0), sight)[0].speed == speed)
    assert allowed == [forward, backward]
    assert scanner.sight(strangers, at(0.0)).body.margin == MARGIN


def test_teammate_known_by_message_does_not_limit_speed() -> None:
    scanner, fast = Scanner(mission(), "robot2"), Command(1.5, 0.0)
    scanner.moved(0.0, fast)
    scanner.process_scan(scan(0.0, post(0.28)), 0.0, at(0.0))
    for mates, zone in (([Mate("robot3", 0.38 + 0j, 0.1)], Zone.CLEAR), ([], Zone.STOP)):
        sight = scanner.sight(scanner.strangers(at(0.0), mates), at(0.0))
        assert protected(fast, sight)[1] is zone


def test_moving_teammate_is_recognised_after_scan() -> None:
    scanner = scanner_after(post(1.0))
    gone_on = Mate("robot3", 1.1 + 0.3j, 0.1, velocity=1j)
    assert scanner.strangers(at(0.3), [gone_on]) == []
    assert scanner.strangers(at(0.3), [gone_on._replace(velocity=0j)])


def test_standing_obstacle_keeps_its_place_between_scans() -> None:
    robot = Robot([(1.5 + 0.3j, 0.1)], noise=0.0, relative_noise=0.0)
    robot.drive(Command(0.4, 0.5), 0.99)  # nearly one period after the last scan
    (circle, *_) = robot.scanner.strangers(at(robot.time), [])
    there = robot.position + robot.heading * circle.at
    assert abs(there - (1.5 + 0.3j)) < 0.12


def test_mission_sweep_overrides_time_increment_of_driver() -> None:
    ends = []
    for sweep in ("", ", sweep = 0.2"):
        scanner = Scanner(mission(scan=sweep), "robot2")
        scanner.moved(0.0, Command(0.0, 1.0))
        ranges = [*[math.inf] * 359, 1.0]
        scanner.process_scan(scan(0.0, ranges, time_increment=3e-5), 0.2, at(0.2))
        (circle,) = scanner.strangers(at(0.2), [])
        ends.append(cmath.phase(circle.at))
    last = -math.tau / 360
    assert ends == pytest.approx([last - 0.2 + 359 * 3e-5, last], abs=1e-6)


def test_only_near_scan_points_become_obstacles() -> None:
    scanner = scanner_after([1.0, *[math.inf] * 179, 3.4, *[math.inf] * 179])
    (one,) = obstacles(scanner.strangers(at(0.0), []), MAX_OBSTACLE_DISTANCE)
    assert one.at == pytest.approx(1.0)


def test_circle_contains_its_points_after_motion() -> None:
    scanner = Scanner(mission(), "robot2")
    scanner.moved(0.0, Command(0.5, 0.3))
    scanner.process_scan(scan(0.0, [1.0, 1.0, 1.0, *[math.inf] * 357]), 0.0, at(0.0))
    (circle,) = scanner.strangers(at(0.4), [])
    assert len(circle.points) == 3
    assert all(abs(point - circle.at) <= circle.radius for point in circle.points)


def test_only_required_scanner_is_silent_without_scans() -> None:
    for says, missed in (("required", math.inf), ("optional", 0.0), ("none", 0.0)):
        assert Scanner(mission(says), "robot2").silence(at(5.0)) == missed


def test_silent_scanner_is_detected_after_three_periods() -> None:
    scanner = scanner_after(post(0.5), 1.0)
    assert scanner.stream.limit == pytest.approx(0.6)
    assert scanner.silence(at(1.5)) == pytest.approx(0.5)
    assert scanner.strangers(at(1.5), [])
    assert scanner.silence(at(1.7)) > scanner.stream.limit
    assert scanner.strangers(at(1.7), []) == []


def test_replayed_scan_is_refused() -> None:
    scanner = scanner_after(post(0.5), 1.0)
    with pytest.raises(BadMessage, match="out of step"):
        scanner.process_scan(scan(1.0, post(0.5)), 1.2, at(1.2))


def test_scan_points_use_mounting_pose_of_mission() -> None:
    scanner = scanner_after(post(1.0), scanning=", x = -0.05, y = 0.02, yaw_deg = 90")
    (circle,) = scanner.strangers(at(0.0), [])
    assert circle.at == pytest.approx(-0.05 + 1.02j)
