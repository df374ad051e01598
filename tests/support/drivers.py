"""Range scans as the ROS 2 drivers of known scanners send them.

A turn is a sequence of samples in the order of time, clockwise: sample k of n is (k + phase) / n of a turn
from the direction in which a turn begins, with a phase from 0 to 1. That direction is ahead for the LDS-01
and the LDS-02, and behind for the RPLIDAR A1, in the frames of their drivers.
"""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Callable, Iterable, Mapping, Sequence

from formation.ros2.messages import LaserScan, decode, encode
from formation.sensing.models import MODELS

PACKET_SAMPLES = 12
"""Samples in a packet of the LDS-02, which has the angles of the first and the last."""
LDS_02_SAMPLE_RATE = 2300
"""[Hz]"""
COMPENSATED_MULTIPLE = 2
"""Beams of a degree that the driver of the A1 makes of 4000 samples in a second."""


TOWER = 0.035
"""Radius of what is seen of a robot [m]."""
BACKGROUND = 3.0
"""Distance of a round wall around the scanner [m]."""


def hls_lfcd(samples: Sequence[float], stamp: float, turn_time: float, _: float = 1.0) -> LaserScan:
    """The scan of an LDS-01 [m]: 360 beams, millimetres, 0 for a lost beam, stamped after the turn [s]."""
    beams = tuple(round(one, 3) if math.isfinite(one) else 0.0 for one in reversed(samples))
    increment, time = math.tau / len(beams), turn_time / len(beams)
    return LaserScan(stamp, 0.0, increment, 0.12, 3.5, beams, time_increment=time, scan_time=turn_time)


def ld08(samples: Sequence[float], stamp: float, _: float, phase: float = 1.0) -> LaserScan:
    """The scan of an LDS-02 [m]: as many beams as there are, NaN where no sample falls into one.

    It begins with the first sample that came back. A packet's step is rounded down to 0.01 °, so samples lie
    up to 0.1 ° beside their angles, and two may fall into one beam: the nearer counts. The limits are 0 and
    100 m. It is stamped after the turn [s].
    """
    speed = round(360.0 * LDS_02_SAMPLE_RATE / len(samples))  # [°/s]
    points = sorted(
        (360.0 - angle, round(one, 3)) for angle, one in _packets(samples, phase) if math.isfinite(one)
    )
    first, last = points[0][0], points[-1][0]
    increment = speed / LDS_02_SAMPLE_RATE
    ranges = [math.nan] * math.ceil((last - first) / increment)
    for angle, distance in points:
        number = int((angle - first) / increment)
        if number < len(ranges) and not distance > ranges[number]:
            ranges[number] = distance
    time = (360.0 / speed) / ((last - first) / increment)
    return LaserScan(
        stamp, math.radians(first), math.radians(increment), 0.0, 100.0, tuple(ranges),
        time_increment=time, scan_time=360.0 / speed,
    )  # fmt: skip


def sllidar(samples: Sequence[float], stamp: float, turn_time: float, phase: float = 1.0) -> LaserScan:
    """The scan of an RPLIDAR A1 [m]: 720 beams from -180 to 180 °, ∞ for a lost one.

    A sample counts for the beam of its angle and the next. The driver puts 720 beams at 719 steps. It is
    stamped before the turn [s].
    """
    beams = 360 * COMPENSATED_MULTIPLE
    ranges = [math.inf] * beams
    for number, distance in enumerate(samples):
        angle = 360.0 * (number + phase) / len(samples) % 360.0
        if math.isfinite(distance):
            for more in range(COMPENSATED_MULTIPLE):
                place = min(beams - 1, int(angle * COMPENSATED_MULTIPLE) + more)
                ranges[beams - 1 - place] = distance
    step, time = math.tau / (beams - 1), turn_time / (beams - 1)
    return LaserScan(
        stamp - turn_time, -math.pi, step, 0.05, 12.0, tuple(ranges),
        time_increment=time, scan_time=turn_time,
    )  # fmt: skip


Driver = Callable[[Sequence[float], float, float, float], LaserScan]
"""Makes a scan of samples [m; ∞ for a lost one], the end of the turn and its duration [s], and the phase."""
DRIVERS: Mapping[str, Driver] = {"lds_01": hls_lfcd, "lds_02": ld08, "rplidar_a1": sllidar}
"""The driver of each model."""

SAMPLES: Mapping[str, int] = {"lds_01": 360, "lds_02": 360, "rplidar_a1": 727}
"""Samples in a turn, about."""


def _packets(samples: Sequence[float], phase: float) -> list[tuple[float, float]]:
    """Angle [°] and range [m] of each sample of an LDS-02."""
    found = []
    for first in range(0, len(samples), PACKET_SAMPLES):
        packet = samples[first : first + PACKET_SAMPLES]
        begin = round(36000.0 * (first + phase) / len(samples))
        end = round(36000.0 * (first + phase + len(packet) - 1) / len(samples))
        step = (end - begin) // max(1, len(packet) - 1)
        found += [((begin + step * number) / 100.0 % 360.0, one) for number, one in enumerate(packet)]
    return found


def distance_along(direction: float, discs: Iterable[tuple[complex, float]], wall: float) -> float:
    """Range of one exact beam from the origin [m]."""
    nearest = wall
    for centre, radius in discs:
        turned = centre * cmath.rect(1.0, -direction)
        if turned.real > 0.0 and abs(turned.imag) < radius:
            nearest = min(nearest, turned.real - math.sqrt(radius**2 - turned.imag**2))
    return nearest


def directions(model: str, count: int, phase: float = 1.0) -> list[float]:
    """Direction of each sample of a turn, in the order of time [rad; scanner's frame]."""
    zero = math.pi if model == "rplidar_a1" else 0.0
    return [zero - math.tau * (number + phase) / count for number in range(count)]


def sent(
    model: str, discs: Iterable[tuple[complex, float]], seed: int, *, wall: float = BACKGROUND, count: int = 0
) -> LaserScan:
    """The scan that the driver sends, as an agent uses it: 10 % of samples are lost.

    Only an LDS-01 measures at the same angles in each turn; `count` is the number of samples, about.
    """
    chance, noise, readings = random.Random(seed), MODELS[model].noise, []
    count, phase = count or SAMPLES[model], 1.0
    if model != "lds_01":
        count, phase = count + chance.randint(-3, 3), chance.random()
    for direction in directions(model, count, phase):
        true = distance_along(direction, discs, wall)
        reading = true + chance.gauss(0.0, noise.deviation(true)) if math.isfinite(true) else true
        readings.append(math.inf if chance.random() < 0.1 else reading)
    scan = DRIVERS[model](readings, 100.0, 1.0 / MODELS[model].rate, phase)
    return MODELS[model].corrected(decode(LaserScan, encode(scan)))
