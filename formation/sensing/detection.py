"""From the beams of a range scan to upright cylinders of a known radius; not in the paper.

Pure, in plain numbers. Consecutive hits at similar distances are a segment. A segment as wide as a cylinder
of the wanted radius, with nothing nearer beside it, may be that cylinder: its centre is in the direction of
the middle beam, at the mean range and π/4 of the radius, which is the mean depth of a half circle. With two
to ten beams no fit is better, and a fit of the radius as well is useless.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from formation.ros2.laser_scan import LaserScan
from formation.sensing.models import BeamNoise

BREAK_DISTANCE, BREAK_DEVIATIONS = 0.06, 4.0
"""Difference of two neighbouring ranges that separates segments [m], and in addition so many deviations."""
MIN_RANGE = 1e-3
"""Least range that is a distance [m]."""
MAX_LOST_BEAMS = 2
"""Most lost beams between two hits of a segment."""
MEAN_DEPTH_SHARE = math.pi / 4.0
"""Mean depth of a half circle, as a share of its radius."""
DEPTH_DEVIATION_SHARE = 0.22
"""Standard deviation of the depth at which one beam meets a half circle, as a share of its radius."""
SHAPE_DEVIATION = 0.003
"""Deviation of a real body from the cylinder [m]."""
BEARING_DEVIATION = 0.002
"""Standard deviation of a beam's direction [rad]."""
WIDTH_TOLERANCE_BEAMS = 2.0
"""Greatest difference of a cylinder's width from the expected one [beams]."""
MAX_WIDTH_RATIO = 3.0
"""Greatest width of a segment that may contain a cylinder, in widths of that: two may stand side by side."""


class Segment(NamedTuple):
    """Consecutive hits at similar distances."""

    first: int
    """Number of its first beam, in the order of the scan."""
    last: int
    """Number of its last beam; from the number of beams on where it continues past the scan's end."""
    hits: int
    distance: float
    """Mean range [m]."""
    free: bool = True
    """Whether nothing nearer is beside it, which may hide a part of it."""

    @property
    def middle(self) -> float:
        """Number of its middle beam."""
        return 0.5 * (self.first + self.last)


class Beams(NamedTuple):
    """The segments of one scan, and the directions of its beams."""

    segments: tuple[Segment, ...]
    """In the order of the scan."""
    angle_min: float
    """Of beam 0, from the scanner's x axis, counter-clockwise [rad]."""
    increment: float
    """From one beam to the next [rad]."""
    beam_count: int
    """Number of beams."""
    range_max: float
    """Longest distance that the scanner measures [m]."""
    noise: BeamNoise = BeamNoise()
    """Of its beams."""

    @property
    def whole_turn(self) -> bool:
        """Whether the last beam is beside the first."""
        return abs(self.beam_count * self.increment) > math.tau - 1.5 * abs(self.increment)

    def covers(self, angle: float, half: float) -> bool:
        """Whether it has beams in all directions within `half` [rad] of `angle` [rad; scanner's frame]."""
        number, width = self.number(angle), half / abs(self.increment)
        return self.whole_turn or width <= number <= self.beam_count - 1 - width

    def angle(self, number: float) -> float:
        """Direction of a beam [rad; scanner's frame]."""
        return self.angle_min + number * self.increment

    def number(self, angle: float) -> float:
        """Number of the beam in a direction [rad; scanner's frame]; it may lie outside the scan."""
        turned = (angle - self.angle_min) / self.increment
        return turned % (math.tau / abs(self.increment))


class Detection(NamedTuple):
    """A cylinder's centre, as one scan shows it."""

    distance: float
    """From the scanner to the centre [m]."""
    angle: float
    """Direction of the centre [rad; scanner's frame]."""
    distance_variance: float
    """[m²]"""
    angle_variance: float
    """[rad²]"""
    whole: bool = True
    """Whether the segment is as wide as the cylinder, with nothing nearer beside it."""


def beams(scan: LaserScan, noise: BeamNoise = BeamNoise()) -> Beams:  # noqa: B008 - a constant
    """Divide a scan into segments; they have this `noise`."""
    ranges, count = scan.ranges, len(scan.ranges)
    nearest, furthest = _nearest(scan), scan.range_max
    found: list[list[int]] = []  # numbers of the hits of each segment
    before, last = -math.inf, -math.inf
    for number, distance in enumerate(ranges):
        if not nearest <= distance <= furthest:
            continue
        if number - last > MAX_LOST_BEAMS + 1 or abs(distance - before) > _break(distance, noise):
            found.append([])
        found[-1].append(number)
        before, last = distance, number
    empty = Beams((), scan.angle_min, scan.angle_increment, count, furthest, noise)
    if empty.whole_turn and len(found) > 1 and _continues(found[-1][-1], found[0][0], ranges, noise):
        found[-1] += [number + count for number in found.pop(0)]
    segments = tuple(_segment(numbers, scan, whole_turn=empty.whole_turn) for numbers in found)
    return empty._replace(segments=segments)


def expected_beams(radius: float, distance: float, increment: float) -> float:
    """Number of beams that meet a cylinder of `radius` [m] with its centre at `distance` [m], on average."""
    return 2.0 * math.asin(min(1.0, radius / max(distance, radius))) / abs(increment)


def detection(segment: Segment, scan: Beams, radius: float) -> Detection | None:
    """The cylinder of `radius` [m] that a segment may be; None if it is so wide that it cannot contain one.

    It is not `whole` if it is too wide or too narrow, or if something nearer beside it may hide a part.
    """
    distance = segment.distance + MEAN_DEPTH_SHARE * radius
    width = segment.last - segment.first + 1
    expected = expected_beams(radius, distance, scan.increment)
    if width > MAX_WIDTH_RATIO * expected + WIDTH_TOLERANCE_BEAMS:
        return None
    noise, hits = scan.noise.deviation(segment.distance), segment.hits
    depth = DEPTH_DEVIATION_SHARE * radius
    middle = scan.noise.middle_beams * scan.increment
    return Detection(
        distance,
        scan.angle(segment.middle),
        noise * noise / hits + depth * depth / hits**3 + SHAPE_DEVIATION * SHAPE_DEVIATION,
        middle * middle + (SHAPE_DEVIATION / distance) ** 2 + BEARING_DEVIATION * BEARING_DEVIATION,
        segment.free and abs(width - expected) <= WIDTH_TOLERANCE_BEAMS,
    )


def around(scan: Beams, angle: float, half: float) -> Iterator[Segment]:
    """The segments with a beam within `half` [rad] of a direction [rad; scanner's frame]."""
    middle, width = scan.number(angle), half / abs(scan.increment)
    for one in scan.segments:
        if abs(_off(scan, one, middle)) <= width + 0.5 * (one.last - one.first) + 0.5:
            yield one


def covered(scan: Beams, segments: Iterable[Segment], angle: float, half: float) -> float:
    """Share of the beams within `half` [rad] of a direction [rad; scanner's frame] that hit `segments`."""
    middle, width = scan.number(angle), half / abs(scan.increment)
    beams_on = 0.0
    for one in segments:
        off, extent = _off(scan, one, middle), 0.5 * (one.last - one.first) + 0.5
        beams_on += max(0.0, min(width, off + extent) - max(-width, off - extent))
    return beams_on / (2.0 * width) if width > 0.0 else 0.0


def _off(scan: Beams, one: Segment, middle: float) -> float:
    """Number of beams from beam `middle` to the middle of a segment, the shorter way round."""
    turn = math.tau / abs(scan.increment)
    return (one.middle - middle + 0.5 * turn) % turn - 0.5 * turn


def _nearest(scan: LaserScan) -> float:
    """Shortest range that is a distance [m]: a range of 0 is a lost beam, also where `range_min` is 0."""
    return max(scan.range_min, MIN_RANGE)


def _break(distance: float, noise: BeamNoise) -> float:
    return BREAK_DISTANCE + BREAK_DEVIATIONS * noise.deviation(distance)


def _continues(last: int, first: int, ranges: Sequence[float], noise: BeamNoise) -> bool:
    """Whether the last hit of a whole turn is beside the first, at a similar distance."""
    beside = first + len(ranges) - last <= MAX_LOST_BEAMS + 1
    return beside and abs(ranges[last] - ranges[first]) <= _break(ranges[first], noise)


def _segment(numbers: Sequence[int], scan: LaserScan, *, whole_turn: bool) -> Segment:
    ranges, count = scan.ranges, len(scan.ranges)
    first, last = numbers[0], numbers[-1]
    begin, end = ranges[first % count], ranges[last % count]
    mean = sum([ranges[number % count] for number in numbers]) / len(numbers)
    free = True
    for step in range(1, MAX_LOST_BEAMS + 2):
        for number, edge in ((first - step, begin), (last + step, end)):
            if not whole_turn and not 0 <= number < count:
                continue
            beside = ranges[number % count]
            if _nearest(scan) <= beside < edge - BREAK_DISTANCE or beside == -math.inf:
                free = False
    return Segment(first, last, len(numbers), mean, free)
