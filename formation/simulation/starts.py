"""Where the followers of a simulation start: as the mission says, or drawn at random around their slots."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from formation.arrays import ComplexArray
from formation.mission import Mission


class Starts(NamedTuple):
    """Where followers start; shapes (R, F)."""

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
    """Control points uniformly within ± `spread` [m] of their slots on each axis, headings uniformly."""
    shape = (runs, len(mission.followers))
    heading = np.exp(1j * rng.uniform(-np.pi, np.pi, shape))
    away = rng.uniform(-spread, spread, shape) + 1j * rng.uniform(-spread, spread, shape)
    offset = np.array([mission.robots[name].control_point_offset for name in mission.followers])
    slots = mission.robots[mission.leader].start.position + np.array(mission.slots()[1:])
    return Starts(slots + away - offset * heading, heading)
