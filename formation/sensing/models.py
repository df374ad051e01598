"""Range scanners by name: what their data sheets promise, and how their ROS 2 drivers send scans.

Sources: the data sheets of LDS-01, LDS-02 (ROBOTIS) and RPLIDAR A1M8 (Slamtec), and the drivers
hls_lfcd_lds_driver, ld08_driver and sllidar_ros2. All three scanners turn clockwise, and all three drivers
publish the beams counter-clockwise, so the first beam of a message is the newest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Literal, NamedTuple

from formation.ros2.laser_scan import MAX_BEAMS, LaserScan

ModelName = Literal["lds_01", "lds_02", "rplidar_a1"]


class BeamNoise(NamedTuple):
    """Standard deviations of one beam.

    Data sheets bound errors of ranges; a bound is taken as two standard deviations.
    """

    least: float = 0.005
    """Of a range, at least [m]."""
    share: float = 0.0175
    """The same as a share of ranges beyond `growth_distance`."""
    growth_distance: float = 0.5
    """[m]"""
    middle_beams: float = 0.3
    """Of the direction of the middle one of the beams that hit an object [beams]."""

    def deviation(self, distance: float) -> float:
        """Standard deviation of a range at `distance` [m]."""
        share = self.share if distance > self.growth_distance else 0.0
        return max(self.least, share * distance)


class ScannerModel(NamedTuple):
    """One model of a range scanner."""

    beams: int
    """In a full turn."""
    range_min: float
    """[m]"""
    range_max: float
    """[m]"""
    rate: float
    """Turns per second, and so scans [Hz]."""
    least_rate: float
    """Slowest turn of a scanner that is well [Hz]."""
    most_rate: float
    """Fastest turn of a scanner that is well [Hz]."""
    noise: BeamNoise
    sweep: float | None = None
    """Time from a scan's first beam to its last, negative if the first is the newest; None if it follows
    from what each scan states [s]."""
    angle_min: float = 0.0
    """Direction of the first beam of a message, counter-clockwise from the scanner's x axis [rad]."""
    beam_shift: float = 0.0
    """From the direction that is stated for a beam to its middle [beams]."""
    newest_first: bool = True
    """Whether a message begins with the newest beam."""
    stamped_late: bool = True
    """Whether a message is stamped when the turn ends, and not when it begins."""

    def corrected(self, scan: LaserScan) -> LaserScan:
        """The scan with the limits of the data sheet, right directions, and beams and times of a full turn.

        The driver of the LDS-02 states limits of 0 and 100 m, and the edge of each beam for its middle. It,
        and that of the A1 without `angle_compensate`, leaves out all beams before the first hit and after the
        last, and still states the duration of a full turn.
        """
        nearest, furthest = max(scan.range_min, self.range_min), min(scan.range_max, self.range_max)
        limited, step, count = (
            replace(scan, range_min=nearest, range_max=furthest), scan.angle_increment, len(scan.ranges),
        )  # fmt: skip
        if step <= math.tau / MAX_BEAMS:  # a full turn would be too long
            return limited
        total = max(count, round(math.tau / step))
        before = min(total - count, max(0, int((scan.angle_min - self.angle_min) / step)))
        lost = (math.inf,)
        return replace(
            limited,
            angle_min=scan.angle_min + (self.beam_shift - before) * step,
            ranges=before * lost + scan.ranges + (total - count - before) * lost,
            time_increment=scan.scan_time / total if scan.scan_time > 0.0 else scan.time_increment,
        )


LDS_01 = ScannerModel(
    beams=360,
    range_min=0.12,
    range_max=3.5,
    rate=5.0,
    least_rate=4.5,
    most_rate=5.5,
    noise=BeamNoise(),  # ±10 mm up to 0.5 m, ±3.5 % beyond
    sweep=-0.2,  # older drivers state 0.01 s
)
LDS_02 = ScannerModel(
    beams=360,
    range_min=0.16,
    range_max=8.0,
    rate=6.4,  # 2300 samples in a second, one for each degree; the data sheet says 5 Hz or above
    least_rate=4.5,
    most_rate=13.0,
    noise=BeamNoise(0.005, 0.015, 0.3, 0.45),  # ±10 mm up to 0.3 m, ±3 % up to 6 m
    beam_shift=0.5,
)
RPLIDAR_A1 = ScannerModel(
    beams=720,
    range_min=0.15,
    range_max=12.0,
    rate=5.5,  # 4000 samples in a second
    least_rate=4.0,
    most_rate=10.5,
    noise=BeamNoise(0.005, 0.005, 0.5, 0.5),  # ±1 %; the data sheet has no bound for near objects
    angle_min=-math.pi,
    stamped_late=False,
)
MODELS: Mapping[str, ScannerModel] = MappingProxyType(
    {"lds_01": LDS_01, "lds_02": LDS_02, "rplidar_a1": RPLIDAR_A1}
)
"""All models, by the names of `ModelName`."""
