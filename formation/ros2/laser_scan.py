"""sensor_msgs/LaserScan: distances to what stands around a robot, one for each beam of a turning scanner.

What a beam says follows REP 117: a number from `range_min` to `range_max` is a distance, +∞ means that there
was nothing, -∞ that something was too near to be measured, NaN that the beam was lost. Of other numbers, such
as the 0 of an LDS-01 for a beam that did not come back, nothing is known, as of a lost beam. So a scan with
such beams is a good scan; a bad one is one whose beams cannot be put where they belong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from formation.ros2 import ros
from formation.ros2.cdr import Reader, Writer, singles
from formation.wire import BadMessage

MAX_BEAMS = 4096
"""Most beams of a scan that is read; an LDS-01 has 360, finer scanners up to some three thousand."""
MAX_ANGLE = 4.0 * math.pi
"""[rad]"""
FINEST = 1e-4
"""Smallest angle from beam to beam [rad]."""
MAX_RANGE = 1e3
"""[m]"""
MAX_TIME = 10.0
"""[s]"""
FULL_TURN = 2.0 * math.pi * (1.0 + 1e-3)
"""From the first beam to the last there is no more than this [rad]."""


@dataclass(frozen=True, slots=True)
class LaserScan:
    """sensor_msgs/LaserScan: one sweep of a range scanner. On the wire numbers have single precision."""

    ROS_TYPE: ClassVar[str] = "sensor_msgs/msg/LaserScan"
    stamp: float
    """Of the first beam [s, sender's system clock]."""
    angle_min: float
    """Of the first beam, from the scanner's x axis, counter-clockwise [rad]."""
    angle_increment: float
    """From one beam to the next; negative where the scanner turns clockwise [rad]."""
    range_min: float
    """[m]"""
    range_max: float
    """[m]"""
    ranges: tuple[float, ...]
    """What each beam says [m]; a lost beam is +∞ here. What numbers mean stands above."""
    time_increment: float = 0.0
    """From one beam to the next [s]; 0 where the scanner does not say."""
    scan_time: float = 0.0
    """From one scan to the next [s]; 0 where the scanner does not say."""
    frame: str = "base_scan"

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        last = self.angle_min + self.angle_increment * (len(self.ranges) - 1)
        times, limits = (self.time_increment, self.scan_time), (self.range_min, self.range_max)
        numbers = singles((self.angle_min, last, self.angle_increment, *times, *limits))
        _check(*numbers)
        _check_beams(len(self.ranges), numbers[2])
        to.floats(numbers)
        to.count(len(self.ranges))
        to.floats(singles(self.ranges))
        to.count(0)  # no intensities

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        numbers = source.floats(7)
        _check(*numbers)
        first, _, increment, time_increment, scan_time, range_min, range_max = numbers
        beams = source.count()
        _check_beams(beams, increment)
        ranges = tuple([r if r == r else math.inf for r in source.floats(beams)])  # noqa: PLR0124 - NaN
        intensities = source.count()
        if intensities not in {0, beams}:
            raise BadMessage(f"{intensities} intensities, must be none or one for each of {beams} beams")
        source.floats(intensities)
        return cls(stamp, first, increment, range_min, range_max, ranges, time_increment, scan_time, frame)


def _check(
    first: float,
    last: float,
    increment: float,
    time_increment: float,
    scan_time: float,
    range_min: float,
    range_max: float,
) -> None:
    """Refuse what no scanner can mean. The last angle is only held to be a number: drivers differ in it."""
    ros.within("angle", MAX_ANGLE, first, last)
    if not FINEST <= abs(increment) <= MAX_ANGLE:
        raise BadMessage(f"angle increment is {increment:g}, must be ±{FINEST:g} rad at least")
    for time in (time_increment, scan_time):
        if not 0.0 <= time <= MAX_TIME:
            raise BadMessage(f"time of a beam or a scan is {time:g} s, must be from 0 to {MAX_TIME:g} s")
    if not 0.0 <= range_min < range_max <= MAX_RANGE:
        raise BadMessage(
            f"ranges from {range_min:g} to {range_max:g} m, must rise, from 0 to {MAX_RANGE:g} m"
        )


def _check_beams(beams: int, increment: float) -> None:
    if not 1 <= beams <= MAX_BEAMS:
        raise BadMessage(f"{beams} beams, must be from 1 to {MAX_BEAMS}")
    if (beams - 1) * abs(increment) > FULL_TURN:
        raise BadMessage(f"{beams} beams {abs(increment):g} rad apart, must be one full turn at most")
