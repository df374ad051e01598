"""Initial poses of a simulation's followers: as the mission says, or random around their slots."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray
from formation.mission.model import Mission
from formation.slots.shape import PlacedShape

MIN_START_CLEARANCE = 0.05
"""Least distance between the bodies at random starts [m]."""
MAX_TRIES = 100
"""Number of tries for a start that is far enough from others; then it stays."""


class Starts(NamedTuple):
    """Initial poses of followers; shapes (R, F)."""

    position: ComplexArray
    """Centres [m; world frame]."""
    heading: ComplexArray
    """Unit complex [world frame]."""


def own_starts(mission: Mission, runs: int) -> Starts:
    """The starts of the mission itself, the same in every run."""
    starts = [mission.robots[name].start for name in mission.followers]
    position = np.array([start.position for start in starts], dtype=np.complex128)
    heading = np.array([start.heading for start in starts], dtype=np.complex128)
    return Starts(np.tile(position, (runs, 1)), np.tile(heading, (runs, 1)))


def random_starts(mission: Mission, runs: int, spread: float, rng: np.random.Generator) -> Starts:
    """Control points uniformly within ± `spread` [m] of their slots on each axis, headings uniformly.

    If two bodies would overlap the later one of them is drawn again.
    """
    shape = (runs, len(mission.followers))
    heading = np.exp(1j * rng.uniform(-np.pi, np.pi, shape))
    away = rng.uniform(-spread, spread, shape) + 1j * rng.uniform(-spread, spread, shape)
    offset = np.array([mission.robots[name].control_point_offset for name in mission.followers])
    slots = mission.robots[mission.leader].start.position + np.array(
        PlacedShape.first(mission).slots(mission)[1:]
    )
    position = slots + away - offset * heading
    radii = np.array([mission.robots[name].radius for name in mission.followers])
    for j in range(1, len(radii)):
        for _ in range(MAX_TRIES):
            distance = np.abs(position[:, :j] - position[:, j : j + 1])
            crowded = np.flatnonzero((distance < radii[:j] + radii[j] + MIN_START_CLEARANCE).any(axis=1))
            if not len(crowded):
                break
            again = rng.uniform(-spread, spread, (2, len(crowded)))
            position[crowded, j] = slots[j] + again[0] + 1j * again[1] - offset[j] * heading[crowded, j]
    return Starts(position, heading)
