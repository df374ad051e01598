"""sensor_msgs/LaserScan: distances to the surroundings of a robot, one for each beam of a turning scanner.

Beams follow REP 117: a number from `range_min` to `range_max` is a distance, +∞ means that nothing was
hit, -∞ that something was too near to be measured, NaN that the beam was lost. Other numbers, such as the
0 of an LDS-01 for a beam that did not come back, count as a lost beam. So a scan with such beams is valid;
one with beams of unknown direction is not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

from formation.ros2 import ros
from formation.ros2.cdr import Reader, Writer, singles
from formation.ros2.ros import Message
from formation.wire import BadMessage

MAX_BEAMS = 4096
"""Most beams of a scan that is read; an LDS-01 has 360, finer scanners up to about three thousand."""
MAX_ANGLE = 4.0 * math.pi
"""[rad]"""
MIN_BEAM_ANGLE = 1e-4
"""Smallest angle from beam to beam [rad]."""
MAX_RANGE = 1e3
"""[m]"""
MAX_TIME = 10.0
"""[s]"""
MAX_SWEEP_ANGLE = 2.0 * math.pi * (1.0 + 1e-3)
"""Greatest angle from the first beam to the last [rad]."""


@dataclass(frozen=True, slots=True)
class LaserScan(Message):
    """sensor_msgs/LaserScan: one sweep of a range scanner. On the wire numbers have single precision."""

    ROS_TYPE: ClassVar[str] = "sensor_msgs/msg/LaserScan"
    DEFINITION: ClassVar[str] = (
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n"
        "float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\n"
        "float32[] ranges\nfloat32[] intensities\n"
    )
    TYPE_HASH: ClassVar[str] = "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
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
    """Each beam's range [m]; a lost beam is +∞ here. The module's docstring explains the numbers."""
    time_increment: float = 0.0
    """From one beam to the next [s]; 0 if unknown."""
    scan_time: float = 0.0
    """From one scan to the next [s]; 0 if unknown."""
    frame: str = "base_scan"
    invalid: bool = field(default=False, compare=False)
    """Whether every beam was sent as NaN, which is no measurement."""

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, self.frame)
        last = self.angle_min + self.angle_increment * (len(self.ranges) - 1)
        times, limits = (self.time_increment, self.scan_time), (self.range_min, self.range_max)
        numbers = singles((self.angle_min, last, self.angle_increment, *times, *limits))
        _check(numbers)
        _check_beams(len(self.ranges), numbers[2])
        to.floats(numbers)
        to.count(len(self.ranges))
        to.floats(singles(self.ranges))
        to.count(0)  # no intensities

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, frame = ros.read_header(source)
        numbers = source.floats(7)
        _check(numbers)
        first, _, increment, time_increment, scan_time, range_min, range_max = numbers
        beams = source.count()
        _check_beams(beams, increment)
        sent = source.floats(beams)
        ranges = tuple([r if r == r else math.inf for r in sent])  # noqa: PLR0124 - NaN
        intensities = source.count()
        if intensities not in {0, beams}:
            raise BadMessage(f"{intensities} intensities, must be none or one for each of {beams} beams")
        source.floats(intensities)
        times = time_increment, scan_time
        invalid = all(map(math.isnan, sent))
        return cls(stamp, first, increment, range_min, range_max, ranges, *times, frame, invalid)


def _check(numbers: Sequence[float]) -> None:
    """Refuse numbers that no scanner can mean. The last angle need only be a number: drivers differ in it."""
    first, last, increment, time_increment, scan_time, range_min, range_max = numbers
    ros.within("angle", MAX_ANGLE, first, last)
    if not MIN_BEAM_ANGLE <= abs(increment) <= MAX_ANGLE:
        raise BadMessage(f"angle increment is {increment:g}, must be ±{MIN_BEAM_ANGLE:g} rad at least")
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
    if (beams - 1) * abs(increment) > MAX_SWEEP_ANGLE:
        raise BadMessage(f"{beams} beams {abs(increment):g} rad apart, must be one full turn at most")
