"""A simulated localiser: poses in the map as AMCL publishes them, rare, uneven, late and noisy."""

from __future__ import annotations

import numpy as np

from formation.control.plane import angle_between, rotation
from formation.ros2.messages import MapPose

UPDATE_DISTANCE, UPDATE_ANGLE = 0.25, 0.2
"""Motion after which AMCL publishes, by default [m; rad]."""
DELAY_SECONDS = 0.15
"""Time from a scan to the pose that is computed from it [s]."""
DEVIATION, HEADING_DEVIATION = 0.02, 0.02
"""Standard deviations of its poses, per axis [m; rad]."""


class Localiser:
    """The localiser of one robot."""

    def __init__(self, noise: np.random.Generator) -> None:
        self._noise = noise
        self._last: tuple[complex, complex] | None = None
        self._waiting: list[tuple[float, MapPose]] = []  # when each is due [s], oldest first

    def poses(self, stamp: float, position: complex, heading: complex) -> list[MapPose]:
        """Return what it publishes at `stamp` [s], when the robot is at `position` [m], `heading` (unit)."""
        if self._last is None or self._moved(position, heading):
            self._last = position, heading
            x, y, turn = self._noise.normal(size=3)
            measured = MapPose(
                stamp,
                position + DEVIATION * complex(x, y),
                heading * rotation(HEADING_DEVIATION * float(turn)),
                DEVIATION,
                HEADING_DEVIATION,
            )
            self._waiting.append((stamp + DELAY_SECONDS, measured))
        due = [pose for when, pose in self._waiting if when <= stamp]
        self._waiting = self._waiting[len(due) :]
        return due

    def _moved(self, position: complex, heading: complex) -> bool:
        at, facing = self._last or (position, heading)
        turned = abs(float(angle_between(facing, heading)))
        return abs(position - at) >= UPDATE_DISTANCE or turned >= UPDATE_ANGLE
