"""Stick together: the leader slows, and waits, while the formation is torn (``[together]`` of a mission).

An edge's error is how far a follower is from where it should be by one whom it measures. While the longest
is under half of the bound the leader goes as it would; from there to the bound it slows to a stand. For whom
it has waited longer than its patience it waits no more, until that robot is back in its place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.figure import Figure
from formation.mission import Mission
from formation.order import LEADER_LOST
from formation.ros2.messages import Pose

SLOWS = 2.0
"""The leader's pace falls by at most so much in a second …"""
QUICKENS = 0.5
"""… and rises by at most so much [1/s]."""


class _Heard(NamedTuple):
    """What a follower told last."""

    arrived: float
    """[s, monotonic]"""
    point: complex
    """Its control point [m; world frame]."""


class Together:
    """How far the team is apart, and how fast the leader may therefore go."""

    def __init__(self, mission: Mission) -> None:
        self.pace = 1.0
        """Share of its speed that the leader may go at."""
        self.error = 0.0
        """The longest edge error that counts [m]."""
        self.waits_for: tuple[str, ...] = ()
        """Whose edges make it slow."""
        self._mission, self._bound = mission, mission.together
        self._heard: dict[str, _Heard] = {}
        self._since: dict[str, float] = {}  # since when each robot has held the team up [s, monotonic]

    def hear(self, robot: str, pose: Pose, arrived: float) -> None:
        """A follower's position has come."""
        point = pose.position + self._mission.robots[robot].control_point_offset * pose.heading
        self._heard[robot] = _Heard(arrived, point)

    def step(self, mono: float, dt: float, leader: complex, velocity: complex, figure: Figure) -> float:
        """The share of its speed that the leader may go at for the next `dt` [s].

        It is at `leader` [m; world frame], at `velocity` [m/s] by its route; slots are where `figure` says.
        """
        if self._bound is None:
            return 1.0
        points = {
            name: heard.point + self.pace * velocity * (mono - heard.arrived)
            for name, heard in self._heard.items()
            if mono - heard.arrived <= LEADER_LOST
        }
        given_up = self._given_up(mono)
        errors = self._errors({self._mission.leader: leader, **points}, figure, given_up)
        late = {name for name, error in errors.items() if error > 0.5 * self._bound.error}
        self._since = {name: self._since.get(name, mono) for name in late}
        counted = {name: error for name, error in errors.items() if name not in given_up}
        self.error = max(counted.values(), default=0.0)
        self.waits_for = tuple(sorted(late & counted.keys(), key=lambda name: -errors[name]))
        wanted = _pace(self.error / self._bound.error)
        self.pace = min(max(wanted, self.pace - SLOWS * dt), self.pace + QUICKENS * dt)
        return self.pace

    def _errors(self, points: dict[str, complex], figure: Figure, given_up: set[str]) -> dict[str, float]:
        """The longest error of each follower's edges to those whom nobody has given up [m]."""
        errors = {}
        for name in points.keys() - {self._mission.leader}:
            slot = figure.slot(self._mission, name)
            edges = [
                abs(points[other] - points[name] - (figure.slot(self._mission, other) - slot))
                for other in self._mission.robots[name].neighbours
                if other in points and other not in given_up
            ]
            errors[name] = max(edges, default=0.0)
        return errors

    def _given_up(self, mono: float) -> set[str]:
        patience = math.inf if self._bound is None or self._bound.patience is None else self._bound.patience
        return {name for name, since in self._since.items() if mono - since > patience}


def _pace(error: float) -> float:
    """1 up to half of the bound, 0 from the bound on, smooth between; `error` as a share of the bound."""
    part = min(max(2.0 * error - 1.0, 0.0), 1.0)
    return 0.5 * (1.0 + math.cos(math.pi * part))
