"""A line of robots, each of which drives to the one before it: rebuilt in the style of turtlebot3_follower.

Each robot knows where it and the one before are by odometry only, from start poses that are told. Ten times
in a second it plans a path from the newest goal but one to the newest, the place of the robot before. Twenty
times in a second it chooses, of all speeds and turn rates that it reaches within a step, those that bring it
nearest to path and goal in 1.7 s (Nav2's dynamic window). Within 0.2 m of the goal, or another distance, it
stands. It never drives backwards. Constants are those that the package ships, but for the greatest speed:
0.15 m/s there, here the robot's own. Written anew from its description.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation.control.unicycle import AT_REST, Command

PLAN_SECONDS, STEP_SECONDS = 0.1, 0.05
HORIZON_SECONDS = 1.7
MAX_TURN_RATE, ACCELERATION, TURN_ACCELERATION = 1.0, 1.5, 3.2
"""[rad/s; m/s²; rad/s²]"""
SPEEDS, TURN_RATES = 40, 20
"""Numbers of speeds and turn rates that are tried."""
AHEAD = 0.1
"""Distance of the point ahead that is aligned [m]."""
Complexes = NDArray[np.complex128]


class Pose(NamedTuple):
    """Centre [m] and heading (unit complex), in the frame that all believe they share."""

    position: complex
    heading: complex


class Follower:
    """One robot of the line."""

    def __init__(self, max_speed: float, gap: float) -> None:
        """`max_speed` [m/s] is the robot's, `gap` the distance from the goal within which it stands [m]."""
        self.command = AT_REST
        self._max_speed, self._gap = max_speed, gap
        self._goal: complex | None = None
        self._before: complex | None = None

    def plan(self, target: Pose) -> None:
        """Take the place of the robot before as the goal."""
        if target.position != self._goal:
            self._goal, self._before = target.position, self._goal

    def step(self, here: Pose) -> Command:
        """Choose the command until the next step."""
        goal = self._goal
        if goal is None or abs(goal - here.position) <= self._gap:
            self.command = AT_REST
            return self.command
        speeds, turn_rates = self._window()
        ends, headings = _ends(here, speeds, turn_rates)
        fronts = ends + AHEAD * headings
        begin = goal if self._before is None else self._before
        beyond = goal + AHEAD * (goal - here.position) / abs(goal - here.position)
        cost = np.abs(ends - goal) + np.abs(fronts - beyond)
        cost = cost + _from_line(ends, begin, goal) + _from_line(fronts, begin, beyond)
        best = np.unravel_index(int(np.argmin(cost)), cost.shape)
        self.command = Command(float(speeds[best[0], 0]), float(turn_rates[0, best[1]]))
        return self.command

    def _window(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Speeds (SPEEDS, 1) and turn rates (1, TURN_RATES) that it can reach."""
        speed, turn_rate = self.command
        change, turn_change = STEP_SECONDS * ACCELERATION, STEP_SECONDS * TURN_ACCELERATION
        most = MAX_TURN_RATE
        lowest, highest = max(-most, turn_rate - turn_change), min(most, turn_rate + turn_change)
        speeds = np.linspace(max(0.0, speed - change), min(self._max_speed, speed + change), SPEEDS)
        turns = np.linspace(lowest, highest, TURN_RATES)
        return speeds[:, None], turns[None, :]


def _ends(
    here: Pose, speeds: NDArray[np.float64], turn_rates: NDArray[np.float64]
) -> tuple[Complexes, Complexes]:
    """Places and headings at the end of the horizon."""
    angles = turn_rates * HORIZON_SECONDS
    chords = np.sinc(angles / (2.0 * np.pi)) * np.exp(0.5j * angles)
    ends = here.position + here.heading * speeds * HORIZON_SECONDS * chords
    return ends, np.broadcast_to(here.heading * np.exp(1j * angles), ends.shape)


def _from_line(points: Complexes, begin: complex, end: complex) -> NDArray[np.float64]:
    """Distance of each point from a path [m]."""
    along = end - begin
    if along == 0.0:
        return np.abs(points - end)
    share = np.clip(((points - begin) * along.conjugate()).real / abs(along) ** 2, 0.0, 1.0)
    return np.abs(points - begin - share * along)
