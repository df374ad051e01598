"""When a start can be in formation at the soonest, whatever law drives it and whatever that law knows.

A run has settled when the formation error, summed over edges, is under `settled`. A robot's distance from
its slot is at most the sum of the errors along any path of edges to the leader, therefore under `settled` as
well. So no run settles before its last robot can be that near to where its slot is by then. Two bounds on how
far a control point gets:

| bound | assumes |
|---|---|
| `by_distance` | the top speed, hypot(u_max, L ω_max), at once in any direction, wherever the robot points |
| `by_body` | Eq. (1) within u_max and ω_max, both at once, no inertia, from the heading that the start has |

Neither knows of neighbours, of an unknown heading or of a delay. Time goes in steps, and is rounded down.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from formation.control.arrays import ComplexArray, FloatArray
from formation.mission.model import Mission
from formation.mission.robot import RobotSpec
from formation.mission.route import Route
from formation.simulation.ensemble import Starts

DIRECTIONS = 36
"""Directions in which `by_body` asks how far a robot gets; fewer make the bound lower, never wrong."""


def by_distance(mission: Mission, starts: Starts, step: float = 0.01) -> FloatArray:
    """Each start's soonest moment by its robots' distances alone [s]; shape (R,)."""
    away = _to_slots(mission, starts)
    top = np.array([mission.robots[name].top_speed for name in mission.followers])  # of control points [m/s]
    soonest = np.full(away.shape, np.nan)
    for moment, gone in _leader(mission, step):
        reached = np.abs(away + gone) <= top * moment + _allowed(mission, step)
        soonest[reached & np.isnan(soonest)] = max(0.0, moment - step)
        if not np.isnan(soonest).any():
            break
    latest: FloatArray = soonest.max(axis=1)
    return latest


def by_body(mission: Mission, starts: Starts, step: float = 0.02) -> FloatArray:
    """Each start's soonest moment with its robots' headings and turn rates minded [s]; shape (R,).

    A slot is out of reach while in some direction it is further away than the control point can get in that
    direction; where the set of what is in reach is not convex, this leaves out what more there is to say.
    """
    soonest = [
        _soonest(mission, index, starts.position[:, index], starts.heading[:, index], step)
        for index in range(len(mission.followers))
    ]
    latest: FloatArray = np.max(soonest, axis=0)
    return latest


def _soonest(
    mission: Mission, index: int, position: ComplexArray, heading: ComplexArray, step: float
) -> FloatArray:
    """One robot's soonest moment from each start [s]; shape (R,)."""
    robot = mission.robots[mission.followers[index]]
    back = np.exp(np.arange(DIRECTIONS) * (-2j * np.pi / DIRECTIONS))
    slot = mission.robots[mission.leader].start.position + mission.slots()[1 + index]
    away = ((slot - position[:, None]) * back).real
    facing = np.angle(heading[:, None] * back) / (2.0 * np.pi)
    soonest, open_ = np.full(len(position), np.nan), np.arange(len(position))
    for (moment, gone), furthest in zip(_leader(mission, step), _reach(robot, step), strict=False):
        cell = np.floor(facing[open_] * len(furthest)).astype(int)  # negative ones count from the end
        near = away[open_] + (gone * back).real <= furthest[cell] + _allowed(mission, step)
        reached = near.all(axis=1)
        soonest[open_[reached]] = max(0.0, moment - step)
        open_ = open_[~reached]
        if not len(open_):
            break
    return soonest


def _reach(robot: RobotSpec, step: float) -> Iterator[FloatArray]:
    """How far the control point gets from the start's centre in one direction [m], step by step.

    By dynamic programming over the time that is left, for cells of the angle between heading and direction; a
    cell is no narrower than a step's turn and counts as the best of its angles, so it is never too little.
    """
    cells = int(2.0 * np.pi / (robot.max_turn_rate * step)) // 4 * 4  # so that 0, π/2 and π are edges
    cosine = np.cos(np.arange(cells + 1) * (2.0 * np.pi / cells))
    furthest = robot.control_point_offset * np.maximum(cosine[:-1], cosine[1:])
    along = np.maximum(np.abs(cosine[:-1]), np.abs(cosine[1:]))
    gain = step * robot.max_speed * _best_near(along)
    while True:
        yield furthest
        furthest = _best_near(furthest) + gain


def _best_near(of_cells: FloatArray) -> FloatArray:
    """The best of each cell and its two neighbours around the circle."""
    return np.maximum(of_cells, np.maximum(np.roll(of_cells, 1), np.roll(of_cells, -1)))


def _leader(mission: Mission, step: float) -> Iterator[tuple[float, complex]]:
    """Moments [s], and how far the leader has gone by then [m; world frame]."""
    route, start = Route.of(mission), mission.robots[mission.leader].start.position
    for number in itertools.count():
        yield step * number, route.position(step * number) - start


def _allowed(mission: Mission, step: float) -> float:
    """What a control point may be away from its slot, and the slot come nearer within a step [m]."""
    return mission.settled + step * max(leg.speed for leg in mission.route)


def _to_slots(mission: Mission, starts: Starts) -> ComplexArray:
    """From each control point to its slot at the beginning [m; world frame]; shape (R, F)."""
    offset = np.array([mission.robots[name].control_point_offset for name in mission.followers])
    slots = mission.robots[mission.leader].start.position + np.array(mission.slots()[1:])
    away: ComplexArray = slots - starts.position - offset * starts.heading
    return away
