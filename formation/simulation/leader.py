"""Positions of a mission's leader at many times at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.unicycle import along
from formation.mission.route import Route
from formation.simulation.compiled import compiled


def positions(route: Route, times: FloatArray) -> ComplexArray:
    """Control points [m; world frame] at `times` [s since the start], which ascend; of their shape."""
    arcs = route.arcs
    starts = np.array(route.begins)
    position = np.array([arc.position for arc in arcs], dtype=np.complex128)
    heading = np.array([arc.heading for arc in arcs], dtype=np.complex128)
    speed = np.array([arc.speed for arc in arcs])
    turn_rate = np.array([arc.turn_rate for arc in arcs])
    found = np.empty(len(times), dtype=np.complex128)
    compiled(_fill)(found, times, starts, position, heading, speed, turn_rate)
    return found


def _fill(
    found: Any, times: Any, starts: Any, position: Any, heading: Any, speed: Any, turn_rate: Any
) -> None:
    arc = 0
    for k in range(len(times)):
        while arc + 1 < len(starts) and starts[arc + 1] <= times[k]:
            arc += 1
        elapsed = max(times[k] - starts[arc], 0.0)
        found[k], _ = along(position[arc], heading[arc], speed[arc] * elapsed, turn_rate[arc] * elapsed)
