"""Cohesion: the leader slows, and waits, while edge errors are large (``[cohesion]`` of a mission).

An edge's error is a follower's distance from its place relative to a neighbour that it measures. While the
largest is under half of the bound, the leader keeps its speed; from there to the bound it slows to a stand.
It stops waiting for a robot after its patience has passed, until that robot is back in its place. On a route
it does not wait for silent robots; driven by hand it does, as a robot in its place would have to catch up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.mission.model import Mission
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.ros2.messages import Pose
from formation.slots.shape import PlacedShape

MAX_PACE_FALL_RATE = 2.0
"""Highest rate at which the leader's pace falls [1/s]."""
MAX_PACE_RISE_RATE = 0.5
"""Highest rate at which the leader's pace rises [1/s]."""


class _LastPosition(NamedTuple):
    """A follower's last position."""

    arrived: float
    """[s, monotonic]"""
    point: complex
    """Its control point [m; world frame]."""


class Cohesion:
    """The largest edge error, and how fast the leader may therefore go."""

    def __init__(self, mission: Mission) -> None:
        self.pace = 1.0
        """Share of its speed that the leader may use."""
        self.error = 0.0
        """The largest edge error that counts [m]."""
        self.waits_for: tuple[str, ...] = ()
        """Robots with edges that slow the leader."""
        self._mission, self._bound = mission, mission.cohesion
        self._received: dict[str, _LastPosition] = {}
        self._since: dict[str, float] = {}  # since when each robot has held the fleet up [s, monotonic]

    def receive(self, robot: str, pose: Pose, arrived: float) -> None:
        """Take in a follower's position, if the leader waits for that follower."""
        if robot not in self._mission.waited_for:
            return
        point = pose.position + self._mission.robots[robot].control_point_offset * pose.heading
        self._received[robot] = _LastPosition(arrived, point)

    def step(
        self,
        mono: float,
        dt: float,
        leader: complex,
        velocity: complex,
        placed_shape: PlacedShape,
        *,
        driven: bool = False,
    ) -> float:
        """Return the share of its speed that the leader may use for the next `dt` [s].

        It is at `leader` [m; world frame] with the route's `velocity` [m/s]; `placed_shape` gives the slots.
        If it is `driven` by hand, it also waits for robots that were received once and are silent.
        """
        if self._bound is None:
            return 1.0
        points = {
            name: received.point + self.pace * velocity * (mono - received.arrived)
            for name, received in self._received.items()
            if mono - received.arrived <= LEADER_TIMEOUT_SECONDS
        }
        silent = self._received.keys() - points.keys() if driven else set()
        given_up = self._given_up(mono)
        errors = self._errors({self._mission.leader: leader, **points}, placed_shape, given_up)
        late = {name for name, error in errors.items() if error > 0.5 * self._bound.error} | silent
        self._since = {name: self._since.get(name, mono) for name in late}
        counted = {name: error for name, error in errors.items() if name not in given_up}
        self.error = max(counted.values(), default=0.0)
        self.waits_for = tuple(sorted(late - given_up, key=lambda name: -errors.get(name, math.inf)))
        wanted = 0.0 if silent - given_up else _pace(self.error / self._bound.error)
        self.pace = min(max(wanted, self.pace - MAX_PACE_FALL_RATE * dt), self.pace + MAX_PACE_RISE_RATE * dt)
        return self.pace

    def _errors(
        self, points: dict[str, complex], placed_shape: PlacedShape, given_up: set[str]
    ) -> dict[str, float]:
        """Return each follower's largest edge error to robots that are not given up [m]."""
        errors = {}
        for name in points.keys() - {self._mission.leader}:
            slot = placed_shape.slot(self._mission, name)
            edges = [
                abs(points[other] - points[name] - (placed_shape.slot(self._mission, other) - slot))
                for other in self._mission.robots[name].neighbours
                if other in points and other not in given_up
            ]
            errors[name] = max(edges, default=0.0)
        return errors

    def _given_up(self, mono: float) -> set[str]:
        patience = math.inf if self._bound is None or self._bound.patience is None else self._bound.patience
        return {name for name, since in self._since.items() if mono - since > patience}


def _pace(error: float) -> float:
    """Return 1 up to half of the bound, 0 from the bound, smooth between; `error`: share of the bound."""
    part = min(max(2.0 * error - 1.0, 0.0), 1.0)
    return 0.5 * (1.0 + math.cos(math.pi * part))
