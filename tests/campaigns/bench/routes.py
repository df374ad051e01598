"""Missions of the control benchmarks: the shipped six robots on four routes, with other leaders and laws.

The leader goes at the mission's 0.2 m/s on all routes. Shapes keep their direction in the world, so every
slot moves as the leader does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.ensemble import Starts, random_starts
from tests.unit.formation import scenarios

SPEED = 0.2
"""[m/s]"""
SIDE = 25.0
"""Time along one side of the square [s]."""
HEADING = 30.0
"""[deg]"""


def _around(turn: str) -> dict[str, Any]:
    """A whole circle of 1 m."""
    return {"radius": 1.0, "speed": SPEED, "turn": turn, "duration": float(2.0 * np.pi / SPEED)}


ROUTES: Mapping[str, Sequence[dict[str, Any]]] = MappingProxyType(
    {
        "line": [{"speed": SPEED, "heading_deg": HEADING}],
        "circle of 1 m": [{"radius": 1.0, "speed": SPEED, "heading_deg": HEADING}],
        "square of 5 m": [
            {"speed": SPEED, "heading_deg": HEADING + 90.0 * corner, "duration": SIDE} for corner in range(8)
        ],
        "figure eight, 1 m": [
            {**_around("left"), "heading_deg": HEADING},
            *(_around(turn) for turn in ("right", "left", "right") * 3),
        ],
    }
)


def six_robots(route: str = "line", leader_speed: float | None = None) -> Mission:
    """The shipped mission on a route, or behind a straight leader of another speed [m/s]."""
    mission = load("six_robots")
    legs = ROUTES[route] if leader_speed is None else [{"speed": leader_speed, "heading_deg": HEADING}]
    return varied(mission, route=legs)


def varied(mission: Mission, **tables: Any) -> Mission:
    """The mission with some of its tables replaced."""
    return Mission.model_validate({**mission.model_dump(), **tables})


def circling_chain(followers: int, **law: Any) -> Mission:
    """One behind the other, half a metre apart, behind a leader on a circle of 1 m at 0.1 m/s."""
    circle = {"radius": 1.0, "speed": 0.1, "heading_deg": 90.0}
    robot = {"control_point_offset": 0.05, "max_turn_rate": 2.84}
    return scenarios.chain(followers, circle, robot, 0.0, **{"k_i": 0.2, **law})


def drawn(mission: Mission, runs: int, seed: int) -> Starts:
    """The starts that `simulate` draws."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    return random_starts(mission, runs, mission.simulation.spread, rng)
