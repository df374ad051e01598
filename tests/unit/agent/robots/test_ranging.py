"""Simulated range scanners on the wire, in a world with posts and walls."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from formation.agent.simulated.simulated import World
from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.ros2.messages import LaserScan, Twist, decode, encode
from formation.sensing.raycast import MIN_NOISE
from formation.wire import Sample
from tests.support.fleet import at

RANGE_NOISE = 6.0 * MIN_NOISE
"""Greatest range error of a scanner with the least possible noise [m]."""
EXACT = "[simulated_scanner]\nnoise = 0.0\nrelative_noise = 0.0\n"


def mission(text: str, scan: str = "rate = 5") -> Mission:
    """Six robots with scanners, and further tables in `text`."""
    whole, name = read("six_robots")
    whole = whole.replace("[robot]", f'[robot]\nscanner = "optional"\nscan = {{ {scan} }}')
    return parse(f"{whole}\n{text}", name)


def scans(world: World, robot: str, until: float = 0.4, reported: Sample | None = None) -> list[LaserScan]:
    found = []
    for tick in range(round(until / 0.01) + 1):
        outbox = world.step(at(0.01 * tick), [reported] if reported and not tick else [])
        found += [decode(LaserScan, out.payload) for out in outbox if out.key == f"{robot}/scan"]
    return found


def beam(scan: LaserScan, toward: complex) -> float:
    """The range in a direction [m; scanner's frame]."""
    angle = math.atan2(toward.imag, toward.real)
    return scan.ranges[round(angle / scan.angle_increment) % len(scan.ranges)]


def test_robots_publish_scans_at_scan_rate() -> None:
    world = World(mission(""))
    keys = [out.key for i in range(1000) for out in world.step(at(0.002 * i), [])]
    assert set(keys) == {key for _, key in world.publications}
    assert {keys.count(f"{name}/scan") for name in world.robots} == {10}


def test_scan_measures_posts_walls_and_other_robots() -> None:
    there = EXACT + "[[simulation.posts]]\nx = -1.5\ny = 3.0\nradius = 0.1\n"
    there += "[[simulation.walls]]\nbegin = [-4.0, 2.5]\nend = [-1.6, 2.5]"
    world = World(mission(there))
    scan = scans(world, "robot2")[0]  # at -1.5 + 2j, facing +y
    assert beam(scan, 1 + 0j) == pytest.approx(0.9, abs=RANGE_NOISE)
    assert beam(scan, 1 + 1j) == pytest.approx(0.5 * math.sqrt(2.0), abs=RANGE_NOISE)
    other = (-3.0 + 1.5j - (-1.5 + 2j)) / 1j
    assert beam(scan, other) == pytest.approx(abs(other) - 0.1, abs=0.01)
    assert beam(scan, -1j) == 0.0  # no object


def test_scan_is_measured_from_mounting_pose() -> None:
    post = EXACT + "[[simulation.posts]]\nx = -1.5\ny = 3.0\nradius = 0.1\n"
    scan = scans(World(mission(post, "x = -0.1, yaw_deg = 90")), "robot2")[0]
    assert beam(scan, -1j) == pytest.approx(1.0, abs=RANGE_NOISE)


def test_sign_of_systematic_errors_differs_between_robots() -> None:
    off = World(mission(f"{EXACT}scale = 0.01\nmounting_error_deg = 5.0\n"), seed=1)

    def nearest(world: World) -> tuple[int, float]:
        """The middle beam on robot3, and its range [m]."""
        ranges = [one if 1.4 < one < 1.6 else math.inf for one in scans(world, "robot2")[0].ranges]
        return ranges.index(min(ranges)), min(ranges)

    (number, distance), (true_number, true) = nearest(off), nearest(World(mission(EXACT)))
    assert abs(number - true_number) == pytest.approx(5, abs=1)
    assert abs(distance / true - 1.0) == pytest.approx(0.01, abs=1e-3)
    scales = {robot.ranging._scale for robot in off._hosted.values() if robot.ranging is not None}
    assert scales == {0.99, 1.01}


def test_scan_shows_seen_circle_of_robots() -> None:
    whole, name = read("six_robots")
    seen = '[robot]\nscanner = "optional"\nseen = { radius = 0.035, x = -0.1 }'
    world = World(parse(f"{whole.replace('[robot]', seen)}\n{EXACT}", name))
    other = -3.0 + 1.5j - 0.1 * (0.5 + 0.5j * math.sqrt(3.0))  # behind robot3, which faces 60 degrees
    toward = (other - (-1.5 + 2j)) / 1j
    assert beam(scans(world, "robot2")[0], toward) == pytest.approx(abs(toward) - 0.035, abs=0.005)


def test_ranges_ahead_decrease_while_robot_drives() -> None:
    post = EXACT + "[[simulation.posts]]\nx = -1.5\ny = 4.0\nradius = 0.1\n"
    ahead = Sample("robot2/cmd_vel", encode(Twist(0.5, 0.0)), None, 0.0)
    seen = scans(World(mission(post)), "robot2", 1.0, ahead)
    steps = [beam(one, 1 + 0j) - beam(two, 1 + 0j) for one, two in pairwise(seen)]
    assert steps == pytest.approx([0.1] * len(steps), abs=RANGE_NOISE)


def test_scan_of_known_model_is_swept() -> None:
    """The first beam is the newest: robot2 drives at a wall and measures it on both sides of its course."""
    wall = EXACT + "[[simulation.walls]]\nbegin = [-9.0, 4.0]\nend = [9.0, 4.0]"
    ahead = Sample("robot2/cmd_vel", encode(Twist(0.5, 0.0)), None, 0.0)
    scan = scans(World(mission(wall, 'model = "lds_01"')), "robot2", 1.0, ahead)[-1]
    newest, oldest = (scan.ranges[number] * math.cos(scan.angle_increment * number) for number in (20, 340))
    assert oldest - newest == pytest.approx(0.5 * 0.18, abs=0.02)
    assert scan.time_increment * len(scan.ranges) == pytest.approx(0.2)
    still = scans(World(mission(wall)), "robot2", 1.0, ahead)[-1]
    assert beam(still, 1 + 0.3j) == pytest.approx(beam(still, 1 - 0.3j), abs=RANGE_NOISE)


@pytest.mark.parametrize(("model", "age", "first"), [("lds_02", 0.0, 0.0), ("rplidar_a1", 0.182, -math.pi)])
def test_stamp_and_first_beam_follow_scanner_model(model: str, age: float, first: float) -> None:
    world, found = World(mission("", f'model = "{model}"')), 0
    for tick in range(60):
        now = at(0.01 * tick)
        for out in world.step(now, []):
            if out.key != "robot2/scan":
                continue
            scan, found = decode(LaserScan, out.payload), found + 1
            assert now.wall - scan.stamp == pytest.approx(age, abs=0.001)
            assert scan.angle_min == pytest.approx(first)
    assert found > 1


def test_scan_noise_and_losses_depend_on_seed() -> None:
    noisy = mission("[simulated_scanner]\nlost = 0.1\n")
    first, again, other = (scans(World(noisy, seed=seed), "robot2")[0] for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_scanner_does_not_change_odometry() -> None:
    def odometry(what: Mission) -> list[bytes]:
        world = World(what)
        result = [out for i in range(50) for out in world.step(at(0.05 * i), [])]
        return [out.payload for out in result if out.key.endswith("odom")]

    assert odometry(mission("")) == odometry(load("six_robots"))
