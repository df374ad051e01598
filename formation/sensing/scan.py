"""From the beams of a range scan to circles that contain their hits; not in the paper.

Pure, in plain numbers. A beam becomes a point in the body frame at the end of its sweep; consecutive
points are enclosed in small circles, the smaller the nearer they are. So a post is one circle or two, and
a wall a chain of them that bulges towards the robot by a tenth of its distance at most. Every point is in
a circle, whatever was lost between two of them: noise and lost beams make more circles, never a gap.
Circles at the reported position of a mate are that mate, all others are strangers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

from formation.control.avoidance import Obstacle
from formation.control.plane import rotation
from formation.control.unicycle import along
from formation.ros2.laser_scan import LaserScan

MAX_RADIUS_SHARE, MIN_RADIUS_LIMIT = 0.1, 0.03
"""Greatest radius of a circle as a share of its distance, or its least limit where that is less [m]."""
MAX_TEAM_MATE_ERROR = 0.1
"""Greatest distance of a mate from its reported position [m]: odometry drifts, ranges are noisy."""
SECTOR_COUNT = 16
"""Number of directions, in each of which the nearest circle is avoided."""
VIEW_STEP = math.radians(5.0)
"""Angle between the directions that are examined, and by which a scan may miss one [rad]."""
MAX_BEAM_WIDTH = math.radians(45.0)
"""Most of a scan's view that one beam stands for [rad]."""


class Mount(NamedTuple):
    """Pose of a scanner on its robot."""

    at: complex = 0j
    """[m; body frame]"""
    heading: complex = 1.0 + 0.0j
    """Of its x axis, unit [body frame]."""


class Motion(NamedTuple):
    """Motion of a body along an arc."""

    distance: float
    """Signed length [m]."""
    turn: float
    """[rad]"""


STOOD = Motion(0.0, 0.0)


class Circle(NamedTuple):
    """A circle around points that a scan has hit next to each other."""

    at: complex
    """Centre [m; body frame]."""
    radius: float
    """[m]"""
    points: tuple[complex, ...] = ()
    """Its points [m; body frame]."""


class Mate(NamedTuple):
    """A mate at its reported position."""

    name: str
    at: complex
    """Centre [m; body frame]."""
    radius: float
    """Of its body [m]."""
    velocity: complex = 0j
    """[m/s; body frame]"""


def points(
    scan: LaserScan, mount: Mount, body_radius: float, motion: Motion = STOOD, *, against: bool = False
) -> list[complex]:
    """The hits of the beams, in the order of the beams [m; body frame at the end of the sweep].

    `motion` is that of the body during the sweep, which begins with the first beam, or with the last if
    the order is `against` time. Hits within `body_radius` [m] of the robot's centre are on its own body.
    """
    nearest, furthest, sits = scan.range_min, scan.range_max, mount.at
    rays = _rays(scan.angle_min, scan.angle_increment, len(scan.ranges), mount.heading)
    found = []
    last = max(1, len(rays) - 1)
    for number, distance in enumerate(scan.ranges):
        near = distance == -math.inf  # the hit is nearer than the scanner can measure
        if not near and not nearest <= distance <= furthest:
            continue
        point = sits + (nearest if near else distance) * rays[number]
        if abs(point) <= body_radius:
            continue
        if near:  # assume the nearest possible
            point = sits + _to_edge(sits, rays[number], body_radius) * rays[number]
        if motion is not STOOD:
            back = -number / last if against else number / last - 1.0
            position, heading = along(0j, 1.0 + 0.0j, back * motion.distance, back * motion.turn)
            point = position + heading * point
        found.append(point)
    return found


@lru_cache(maxsize=8)
def unseen(first: float, increment: float, beams: int, heading: complex) -> tuple[complex, ...]:
    """The directions, `VIEW_STEP` apart, in which a scan has no beam; unit [body frame].

    Its beams begin at `first` [rad; scanner's frame] and are `increment` [rad] apart; the scanner's x axis
    is `heading` [body frame].
    """
    turn = math.tau / abs(increment)  # [beams]
    half = (0.5 * min(abs(increment), MAX_BEAM_WIDTH) + VIEW_STEP) / abs(increment)
    found = []
    for step in range(round(math.tau / VIEW_STEP)):
        direction = rotation(step * VIEW_STEP)
        in_scan = direction * heading.conjugate()
        number = (math.atan2(in_scan.imag, in_scan.real) - first) / increment % turn
        nearest = min(round(number), beams - 1)
        if min(abs(number - nearest), turn - number) > half:
            found.append(direction)
    return tuple(found)


def circles(found: Iterable[complex], increment: float) -> list[Circle]:
    """Small circles that contain all points of a scan, `increment` [rad] from beam to beam.

    They extend past their outermost points by half the distance of two beams, for objects between two.
    """
    half = 0.5 * abs(increment)
    return [_around(chunk, half) for chunk in _chunks(found)]


def carried(found: Sequence[Circle], motion: tuple[complex, complex]) -> list[Circle]:
    """The circles after a motion of the body, to the pose `motion` in the earlier frame."""
    position, heading = motion
    back = heading.conjugate()
    return [
        Circle(back * (at - position), radius, tuple([back * (point - position) for point in held]))
        for at, radius, held in found
    ]


def mate(circle: Circle, mates: Iterable[Mate]) -> str | None:
    """Name of the mate; None for a stranger, and for a circle that only touches a mate."""
    for one in mates:
        if abs(circle.at - one.at) + circle.radius <= one.radius + MAX_TEAM_MATE_ERROR:
            return one.name
    return None


def strangers(found: Iterable[Circle], mates: Sequence[Mate]) -> list[Circle]:
    """The circles that are no mates, and so unknown to the network."""
    return [circle for circle in found if mate(circle, mates) is None]


def obstacles(found: Iterable[Circle], within: float) -> tuple[Obstacle, ...]:
    """In each of `SECTOR_COUNT` directions the nearest circle nearer than `within` [m], nearest first.

    They have right of way, because they do not know of this robot, and are assumed to stand: along a wall
    the difference of two scans is noise and not a velocity.
    """
    nearest: dict[int, tuple[float, Circle]] = {}
    for circle in found:
        clearance = abs(circle.at) - circle.radius
        sector = (
            int(math.atan2(circle.at.imag, circle.at.real) / math.tau * SECTOR_COUNT + SECTOR_COUNT)
            % SECTOR_COUNT
        )
        if clearance < within and (sector not in nearest or clearance < nearest[sector][0]):
            nearest[sector] = clearance, circle
    ordered = sorted(nearest.values(), key=lambda one: one[0])
    return tuple(Obstacle(circle.at, circle.radius, 0j, first=True, stands=True) for _, circle in ordered)


def _to_edge(sits: complex, ray: complex, radius: float) -> float:
    """Distance from a scanner along a ray to the edge of the body [m]; 0 for one outside it."""
    along, aside = (sits * ray.conjugate()).real, (sits * ray.conjugate()).imag
    return math.sqrt(radius * radius - aside * aside) - along if abs(sits) < radius else 0.0


@lru_cache(maxsize=8)
def _rays(first: float, increment: float, beams: int, heading: complex) -> tuple[complex, ...]:
    """Directions of all beams, unit [body frame]; equal for all scans of a scanner."""
    return tuple(heading * rotation(first + number * increment) for number in range(beams))


def _chunks(found: Iterable[complex]) -> Iterator[list[complex]]:
    """Consecutive points, as many as fit into a small circle."""
    chunk: list[complex] = []
    left = right = low = high = limit = 0.0
    for point in found:
        x, y = point.real, point.imag
        if chunk:
            west, east, south, north = min(left, x), max(right, x), min(low, y), max(high, y)
            if (east - west) * (east - west) + (north - south) * (north - south) <= limit:
                left, right, low, high = west, east, south, north
                chunk.append(point)
                continue
            yield chunk
        chunk, left, right, low, high = [point], x, x, y, y
        limit = 4.0 * max(MIN_RADIUS_LIMIT, MAX_RADIUS_SHARE * abs(point)) ** 2  # of a diagonal, squared
    if chunk:
        yield chunk


def _around(chunk: Sequence[complex], half: float) -> Circle:
    xs, ys = [point.real for point in chunk], [point.imag for point in chunk]
    centre = complex(0.5 * (min(xs) + max(xs)), 0.5 * (min(ys) + max(ys)))
    reach = max([abs(point - centre) for point in chunk])
    return Circle(centre, reach + half * abs(centre), tuple(chunk))
