"""A simulated robot's range scanner: what it measures from the robot's true pose."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from formation.agent.simulated.moving import Moving
from formation.mission.model import Mission
from formation.ros2.messages import LaserScan
from formation.sensing.raycast import cast, measured
from formation.transport.runtime.rate import Rate


class Ranging:
    """One robot's scanner. A scan is of one moment: all its beams are measured at once."""

    def __init__(self, mission: Mission, robot: str, noise: np.random.Generator, phase: float) -> None:
        """It publishes at the mission's rate, `phase` [periods] after others."""
        self.rate = Rate(mission.robots[robot].scan.rate, phase)
        self._mount, self._scanner = mission.robots[robot].scan.mount, mission.simulated_scanner.scanner
        self._posts = tuple(post.disc for post in mission.simulation.posts)
        self._walls = tuple(wall.line for wall in mission.simulation.walls)
        self._noise = noise

    def scan(self, stamp: float, plant: Moving, others: Iterable[tuple[complex, float]]) -> LaserScan:
        """Return the scan at `stamp` [s]; `others` are other robots' bodies: centre, radius [m; world]."""
        scanner, mount = self._scanner, self._mount
        true = plant.cast(mount.at, mount.heading, scanner.beams, scanner.range_max)
        if true is None:
            at, heading = plant.position + plant.heading * mount.at, plant.heading * mount.heading
            true = cast(at, heading, (*others, *self._posts), self._walls, scanner.beams)
        normal, uniform = self._noise.normal(size=scanner.beams), self._noise.random(scanner.beams)
        return LaserScan(
            stamp,
            angle_min=0.0,
            angle_increment=math.tau / scanner.beams,
            range_min=scanner.range_min,
            range_max=scanner.range_max,
            ranges=measured(true, scanner, normal.tolist(), uniform.tolist()),
            scan_time=self.rate.period,
        )
