"""`python -m tests.campaigns.perception.towers`: one robot's tower in one scan of each driver, found or not.

One line for each scanner: mean and deviation of the error of distance and direction, and the mean square of
the direction's error in units of the deviation that the detection states.
"""

from __future__ import annotations

import cmath
import math
from statistics import fmean, pstdev
from typing import NamedTuple

from formation.sensing.detection import beams, detection
from formation.sensing.models import MODELS
from tests.support.drivers import BACKGROUND, SAMPLES, TOWER, sent

SCANS = 400
MAX_OFF = 0.1
"""Greatest difference of directions at which a segment is the tower [rad]."""


class Errors(NamedTuple):
    """Errors of the centres that were found."""

    distances: list[float]
    """[m]"""
    directions: list[float]
    """[rad]"""
    squares: list[float]
    """Of the direction's error, in units of its stated variance."""


def errors(model: str, *, wall: float = BACKGROUND, count: int = 0, scans: int = SCANS) -> Errors:
    """Look for a tower at 0.7 to 1.1 m in so many scans with `count` samples, by default the model's."""
    found = Errors([], [], [])
    for seed in range(scans):
        angle, distance = 0.37 * seed, 0.7 + 0.4 * seed / scans
        towers = [(cmath.rect(distance, angle + beside), TOWER) for beside in (0.0, 2.0)]
        scan = beams(sent(model, towers, seed, wall=wall, count=count), MODELS[model].noise)
        for segment in scan.segments:
            one = detection(segment, scan, TOWER)
            off = math.remainder(one.angle - angle, math.tau) if one is not None else math.inf
            if one is not None and one.whole and abs(off) < MAX_OFF:
                found.distances.append(one.distance - distance)
                found.directions.append(off)
                found.squares.append(off * off / one.angle_variance)
    return found


def main() -> None:
    """Print the errors of each scanner, among walls and in an empty hall."""
    for model, count in (*SAMPLES.items(), ("lds_02", 230), ("lds_02", 460), ("rplidar_a1", 533)):
        for place, wall in (("walls at 3 m", BACKGROUND), ("empty hall", math.inf)):
            found = errors(model, wall=wall, count=count)
            degrees = [math.degrees(one) for one in found.directions]
            print(
                f"{model}, {count} samples, {place}: found {len(found.distances) / SCANS:.0%}, distance"
                f" {1e3 * fmean(found.distances):.1f} ± {1e3 * pstdev(found.distances):.1f} mm, direction"
                f" {fmean(degrees):.2f} ± {pstdev(degrees):.2f}°, square {fmean(found.squares):.2f}"
            )


if __name__ == "__main__":
    main()
