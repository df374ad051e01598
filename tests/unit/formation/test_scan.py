"""Range scans: simulated beams, circles around their hits, and the robot that each circle belongs to."""

from __future__ import annotations

import cmath
import math
import random

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from formation.control.unicycle import along
from formation.ros2.messages import LaserScan
from formation.sensing.raycast import LOST_RANGE, Scanner, cast, measured
from formation.sensing.scan import (
    MAX_RADIUS_SHARE,
    MAX_TEAM_MATE_ERROR,
    MIN_RADIUS_LIMIT,
    SECTOR_COUNT,
    Circle,
    Mate,
    Motion,
    Mount,
    carried,
    circles,
    mate,
    obstacles,
    points,
    strangers,
)

BEAMS, FEW = 360, 72
metres = st.floats(-5.0, 5.0)
places = st.builds(complex, metres, metres)
headings = st.floats(-math.pi, math.pi).map(lambda angle: cmath.rect(1.0, angle))
discs = st.lists(st.tuples(places, st.floats(0.01, 0.5)), max_size=4)
walls = st.lists(st.tuples(places, places), max_size=4)


def ray(number: int, heading: complex, beams: int) -> complex:
    return heading * cmath.rect(1.0, number * math.tau / beams)


def off_wall(point: complex, begin: complex, end: complex) -> float:
    """The distance of a point from a wall."""
    way = end - begin
    share = ((point - begin) * way.conjugate()).real / max(abs(way) ** 2, 1e-300)
    return abs(point - begin - min(max(share, 0.0), 1.0) * way)


@given(places, headings, discs, walls)
def test_beam_ends_on_a_surface_and_passes_through_no_disc(
    at: complex, heading: complex, discs: list[tuple[complex, float]], walls: list[tuple[complex, complex]]
) -> None:
    found = cast(at, heading, discs, walls, FEW)
    for number, distance in enumerate(found):
        if distance in {0.0, math.inf}:
            continue
        end = at + distance * ray(number, heading, FEW)
        on = [abs(abs(end - centre) - radius) for centre, radius in discs]
        on += [off_wall(end, *wall) for wall in walls]
        assert min(on) < 1e-5
        for share in (0.1, 0.5, 0.9, 0.999):
            point = at + share * distance * ray(number, heading, FEW)
            assert all(abs(point - centre) > radius - 1e-6 for centre, radius in discs)


@given(places, headings, discs.filter(bool))
def test_beam_towards_a_disc_hits_it(
    at: complex, heading: complex, discs: list[tuple[complex, float]]
) -> None:
    found = cast(at, heading, discs, [], BEAMS)
    for centre, radius in discs:
        distance = abs(centre - at)
        if distance > radius / math.sin(math.tau / BEAMS) or distance <= radius:
            continue  # narrower than the space between two beams, or all around
        number = round(cmath.phase((centre - at) / heading) / math.tau * BEAMS) % BEAMS
        assert found[number] <= distance


@pytest.mark.parametrize("wall", [(2 - 1j, 2 + 1j), (2 + 1j, 2 - 1j)])
def test_ranges_of_wall_ahead_match_geometry(wall: tuple[complex, complex]) -> None:
    found = cast(0j, 1 + 0j, [], [wall], BEAMS)
    assert found[0] == pytest.approx(2.0)
    assert found[20] == pytest.approx(2.0 / math.cos(math.radians(20)))
    assert found[27] == found[180] == math.inf  # past its end, and behind
    assert found[340] == pytest.approx(found[20])


def test_disc_hides_objects_behind_it() -> None:
    found = cast(0j, 1 + 0j, [(1 + 0j, 0.1), (2 + 0j, 0.1)], [(3 - 3j, 3 + 3j)], BEAMS)
    assert found[0] == pytest.approx(0.9)
    assert found[30] == pytest.approx(3.0 / math.cos(math.radians(30)))
    assert set(cast(0j, 1 + 0j, [(0.05 + 0j, 0.1)], [], BEAMS)) == {0.0}  # within a disc


@given(places, headings, discs, walls)
def test_mirrored_world_gives_mirrored_scan(
    at: complex, heading: complex, discs: list[tuple[complex, float]], walls: list[tuple[complex, complex]]
) -> None:
    assume(all(off_wall(at, *wall) > 1e-3 for wall in walls))  # a scanner on a wall is on one side of it
    found = cast(at, heading, discs, walls, FEW)
    mirrored_discs = [(centre.conjugate(), radius) for centre, radius in discs]
    mirrored_walls = [(begin.conjugate(), end.conjugate()) for begin, end in walls]
    mirrored = cast(at.conjugate(), heading.conjugate(), mirrored_discs, mirrored_walls, FEW)
    # at an edge, rounding decides whether a beam hits
    differ = [n for n in range(FEW) if abs(found[n] - mirrored[-n % FEW]) > 1e-6]
    assert len(differ) <= 2 * (len(discs) + len(walls))


def test_measured_ranges_have_stated_noise_and_loss() -> None:
    rng, beams = random.Random(1), 20_000
    normal = [rng.gauss(0.0, 1.0) for _ in range(beams)]
    uniform = [rng.random() for _ in range(beams)]
    for distance, noise in ((0.3, 0.005), (3.0, 0.0525)):
        ranges = measured([distance] * beams, Scanner(lost=0.1), normal, uniform)
        seen = [one for one in ranges if one != LOST_RANGE]
        assert len(seen) / beams == pytest.approx(0.9, abs=0.01)
        rms = math.sqrt(sum((one - distance) ** 2 for one in seen) / len(seen))
        assert rms == pytest.approx(noise, rel=0.03)


@pytest.mark.parametrize("distance", [0.05, 4.0, math.inf])
def test_distance_outside_scanner_range_is_lost(distance: float) -> None:
    assert measured([distance], Scanner(), [0.0], [0.5]) == (LOST_RANGE,)


STEP = math.tau / 360
HERE = Mount()
distances = st.floats(0.0, 4.0) | st.sampled_from((math.inf, -math.inf, 0.0))
sweeps = st.lists(distances, min_size=1, max_size=90).map(tuple)
angles = st.floats(-math.pi, math.pi)
mounts = st.builds(
    Mount,
    st.builds(complex, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    angles.map(lambda a: cmath.rect(1, a)),
)
motions = st.builds(Motion, st.floats(-0.3, 0.3), st.floats(-1.0, 1.0))


def scan(ranges: tuple[float, ...], step: float = STEP) -> LaserScan:
    return LaserScan(0.0, 0.0, step, 0.12, 3.5, ranges)


def seen(
    discs: list[tuple[complex, float]],
    walls: list[tuple[complex, complex]],
    scanner: Scanner = Scanner(noise=0.0, relative_noise=0.0),  # noqa: B008 - a constant
    seed: int = 0,
) -> list[Circle]:
    """The circles that a robot at the origin finds in a world."""
    rng = random.Random(seed)
    normal = [rng.gauss(0.0, 1.0) for _ in range(360)]
    uniform = [rng.random() for _ in range(360)]
    ranges = measured(cast(0j, 1 + 0j, discs, walls, 360), scanner, normal, uniform)
    return circles(points(scan(ranges), HERE, 0.1), STEP)


def clearance(found: list[Circle], point: complex) -> float:
    return min((abs(point - circle.at) - circle.radius for circle in found), default=math.inf)


# Every scan


@given(sweeps, mounts, motions, st.sampled_from((STEP, 4 * STEP, -STEP)))
def test_every_hit_is_in_a_circle(
    ranges: tuple[float, ...], mount: Mount, motion: Motion, step: float
) -> None:
    hits = points(scan(ranges, step), mount, 0.1, motion)
    found = circles(hits, step)
    assert all(clearance(found, hit) <= 1e-9 for hit in hits)


@given(sweeps, mounts)
def test_circle_radius_is_limited_by_distance(ranges: tuple[float, ...], mount: Mount) -> None:
    for circle in circles(points(scan(ranges), mount, 0.1), STEP):
        # the first point is no further away than centre distance plus radius
        furthest = abs(circle.at) + circle.radius
        largest = max(MIN_RADIUS_LIMIT, MAX_RADIUS_SHARE * furthest) + 0.5 * STEP * abs(circle.at)
        assert circle.radius <= largest + 1e-9


@given(sweeps, mounts)
def test_mirrored_scan_gives_mirrored_points(ranges: tuple[float, ...], mount: Mount) -> None:
    there = points(scan(ranges), mount, 0.1)
    mirrored = points(scan(ranges, -STEP), Mount(mount.at.conjugate(), mount.heading.conjugate()), 0.1)
    assert mirrored == pytest.approx([point.conjugate() for point in there], abs=1e-9)


@given(sweeps, mounts, angles)
def test_rotated_mount_gives_rotated_points(ranges: tuple[float, ...], mount: Mount, angle: float) -> None:
    turn = cmath.rect(1.0, angle)
    there = points(scan(ranges), mount, 0.0)
    turned = points(scan(ranges), Mount(mount.at * turn, mount.heading * turn), 0.0)
    assert turned == pytest.approx([point * turn for point in there], abs=1e-9)


@given(sweeps, st.floats(0.0, 1.0))
def test_points_inside_own_body_are_dropped(ranges: tuple[float, ...], radius: float) -> None:
    ranges = tuple(distance for distance in ranges if distance > 0.0) or (math.inf,)
    hits = points(scan(ranges), Mount(0.05 + 0j), radius)
    assert all(abs(hit) > radius for hit in hits)
    everything = points(scan(ranges), Mount(0.05 + 0j), 0.0)
    assert hits == [hit for hit in everything if abs(hit) > radius]


@given(motions, st.floats(0.2, 2.0), angles)
def test_points_of_scan_in_motion_refer_to_last_beam(motion: Motion, distance: float, angle: float) -> None:
    post, beams = cmath.rect(distance + 1.0, angle), 24
    hits = []
    for number in range(beams):  # each beam hits the post from the robot's pose at that time
        share = number / (beams - 1)
        position, heading = along(0j, 1 + 0j, share * motion.distance, share * motion.turn)
        there = (post - position) / heading
        ranges = tuple(abs(there) if one == number else math.inf for one in range(beams))
        mount = Mount(0j, there / abs(there) / cmath.rect(1.0, number * STEP))
        hits += points(scan(ranges), mount, 0.0, motion)
    position, heading = along(0j, 1 + 0j, *motion)
    assert hits == pytest.approx([(post - position) / heading] * beams, abs=1e-9)


@given(sweeps, motions)
def test_carried_circles_keep_their_world_position(ranges: tuple[float, ...], motion: Motion) -> None:
    found = circles(points(scan(ranges), HERE, 0.1), STEP)
    position, heading = along(0j, 1 + 0j, *motion)
    places = [position + heading * circle.at for circle in carried(found, (position, heading))]
    assert places == pytest.approx([circle.at for circle in found], abs=1e-9)


# Posts, walls, doorways


@given(mounts, st.floats(0.0, 0.5))
def test_too_near_echo_is_placed_on_body_edge(mount: Mount, radius: float) -> None:
    found = points(scan((-math.inf,)), mount, radius)
    if abs(mount.at + 0.12 * mount.heading) <= radius:
        assert found == []
        return
    (point,) = found
    assert abs(point) == pytest.approx(max(radius, abs(mount.at)))
    along_ray = (point - mount.at) / mount.heading
    assert -1e-9 <= along_ray.real <= 0.12 + 1e-9
    assert along_ray.imag == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("says", [0.0, 0.05, 3.6, 100.0, math.inf])
def test_beam_without_valid_range_gives_no_point(says: float) -> None:
    assert points(scan((says,)), HERE, 0.1) == []


@pytest.mark.parametrize("distance", [0.3, 1.0, 2.0])
def test_post_is_covered_by_few_small_circles(distance: float) -> None:
    found = seen([(distance + 0j, 0.05)], [])
    assert 1 <= len(found) <= 3
    surfaces = [distance + cmath.rect(0.05, number * STEP) for number in range(360)]
    in_sight = [surface for surface in surfaces if abs(surface) < distance - 0.03]
    assert all(clearance(found, surface) < 0.01 for surface in in_sight)
    assert min(abs(circle.at) - circle.radius for circle in found) > distance - 0.05 - 0.06
    (thin,) = seen([(distance + 0j, 0.005 * distance)], [])  # as thin as a beam
    assert abs(thin.at - 0.995 * distance) < 1e-5
    assert 0.0 < thin.radius < 0.015 * distance


def test_wall_is_covered_by_chain_of_small_circles() -> None:
    found = seen([], [(-2 + 0.5j, 2 + 0.5j)])
    assert len(found) > 10
    assert max(circle.radius for circle in found) < 0.25
    # circles reach towards the robot by about a tenth of the distance at most
    assert min(abs(circle.at) - circle.radius for circle in found) > 0.5 - 0.07
    for step in range(-20, 21):
        assert clearance(found, complex(0.05 * step, 0.5)) < 0.02


def test_circles_leave_a_doorway_free() -> None:
    found = seen([], [(1 - 3j, 1 - 0.4j), (1 + 0.4j, 1 + 3j)])
    assert min(clearance(found, complex(0.01 * step, 0.0)) for step in range(200)) > 0.2
    assert clearance(found, 1 + 0.45j) < 0.03
    assert clearance(found, 1 - 0.45j) < 0.03


@pytest.mark.parametrize("seed", range(20))
def test_post_and_wall_remain_despite_noise_and_losses(seed: int) -> None:
    found = seen([(1 + 0j, 0.1)], [(-2 - 1j, 2 - 1j)], Scanner(lost=0.1), seed)
    assert clearance(found, 0.9 + 0j) < 0.06
    for step in range(-10, 11):
        assert clearance(found, complex(0.1 * step, -1.0)) < 0.12
    assert clearance(found, 0.45 + 0j) > 0.3  # free space stays free
    assert clearance(found, -0.5 + 0.5j) > 0.3


# Team mates and strangers


def test_only_unknown_circles_are_strangers() -> None:
    found = seen([(1 + 0j, 0.1), (1j, 0.1)], [])
    mates = [Mate("robot2", 1.03 - 0.02j, 0.1)]
    assert {mate(circle, mates) for circle in found} == {"robot2", None}
    assert all(abs(circle.at - 1j) < 0.2 for circle in strangers(found, mates))
    assert strangers(found, mates)
    assert strangers(found, [Mate("robot2", 1 + 0.5j, 0.1)]) == found  # away from its position


def test_circle_reaching_beyond_team_mate_is_a_stranger() -> None:
    there = Mate("robot2", 1 + 0j, 0.1)
    assert mate(Circle(1.1 + 0j, MAX_TEAM_MATE_ERROR - 0.01), [there]) == "robot2"
    assert mate(Circle(1.1 + 0j, MAX_TEAM_MATE_ERROR + 0.01), [there]) is None


# Obstacles


def test_obstacles_are_few_sorted_by_distance_and_in_range() -> None:
    found = seen([(0.5 + 0j, 0.05), (0.9j, 0.1)], [(-3 - 2j, 3 - 2j)])
    avoided = obstacles(found, 1.5)
    assert len(avoided) <= SECTOR_COUNT
    near = [abs(one.at) - one.radius for one in avoided]
    assert near == sorted(near)
    assert near[-1] < 1.5
    assert min(near) == pytest.approx(min(abs(circle.at) - circle.radius for circle in found))
    assert {(one.velocity, one.first) for one in avoided} == {(0j, True)}


@given(st.lists(st.builds(Circle, st.builds(complex, st.floats(-3, 3), st.floats(-3, 3)), st.floats(0, 0.2))))
def test_nearest_circle_is_always_an_obstacle(found: list[Circle]) -> None:
    avoided = obstacles(found, math.inf)
    assert bool(avoided) == bool(found)
    if found:
        nearest = min(abs(circle.at) - circle.radius for circle in found)
        assert abs(avoided[0].at) - avoided[0].radius == nearest
