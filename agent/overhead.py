"""Positions from outside: an overhead camera or motion capture that sees the robot in the world frame.

This is the paper's other source. How far the robot went and turned between two positions is taken from the
commands that it was sent, as in the paper; odometry is not read.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from agent.odometer import impossible
from agent.sighting import Sighting
from formation.heading import Travel
from formation.mission import Mission
from formation.plane import angle_between, rotation
from formation.ros2.messages import Pose
from formation.unicycle import Command

KEPT = 5.0
"""Commands older than this are forgotten [s]."""
COASTING = 0.5
"""For about so long a robot goes on after its agent's death: it is told, and comes, to stand [s]."""


class Sent(NamedTuple):
    """A command and when it was sent [s, monotonic]; it holds until the next."""

    since: float
    command: Command


class Overhead:
    """One robot seen from outside."""

    name = "pose"
    alignment = "positions from outside, in the world frame"
    doubt: str | None = None
    realigned = 0

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self._limits = spec.limits
        self._reads_heading = spec.heading == "measured"
        self._last: Pose | None = None
        self._sent: deque[Sent] = deque()

    def told(self, moment: float, command: Command) -> None:
        """The robot was sent `command` at `moment` [s, monotonic]."""
        while len(self._sent) > 1 and self._sent[1].since < moment - KEPT:
            self._sent.popleft()
        if not self._sent or self._sent[-1].command != command:
            self._sent.append(Sent(moment, command))

    def unlike(self, pose: Pose, over: float) -> str | None:
        """Why nobody knows how the robot has turned in the `over` [s] since the newest position, in words.

        It was told nothing since: who has moved was carried, or has gone on driving with nobody to stop it.
        """
        if self._last is None:
            return "it had not been seen"
        moved, over = abs(pose.position - self._last.position), min(over, COASTING)
        jumped = impossible(moved, 0.0, self._limits.max_speed, self._limits.max_turn_rate, over)
        return jumped and f"it moved {jumped} though nobody drove it"

    def stood(self, since: float) -> None:
        """Take it that the robot has stood since then [s, monotonic]: whoever drove it is gone."""
        self._sent = deque([Sent(since, Command(0.0, 0.0))])

    def see(self, pose: Pose, over: float | None, moment: float) -> Sighting:
        """Where it was seen at `moment` [s, monotonic], `over` [s] after it was seen before."""
        last, self._last = self._last, pose
        if last is None or over is None:
            return Sighting(pose.position, pose.heading, None)
        distance, turn = self._driven(moment - over, moment)
        moved, seen_turn = pose.position - last.position, 0.0
        if self._reads_heading:  # that a robot was turned by hand is seen as well
            turn = seen_turn = float(angle_between(last.heading, pose.heading))
        jumped = impossible(abs(moved), seen_turn, self._limits.max_speed, self._limits.max_turn_rate, over)
        return Sighting(pose.position, pose.heading, Travel(distance, turn, moved), jumped, rotation(turn))

    def _driven(self, start: float, end: float) -> tuple[float, float]:
        """What the commands make of the time between: path length [m] and turn [rad]."""
        distance, turn, until = 0.0, 0.0, end
        for since, command in reversed(self._sent):
            if until <= start:
                break
            held = max(0.0, until - max(since, start))
            distance += command.speed * held
            turn += command.turn_rate * held
            until = min(until, since)
        return distance, turn
