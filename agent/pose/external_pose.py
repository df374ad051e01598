"""External poses: a camera or motion capture measures the robot in the world frame.

This is the paper's other source. The distance and turn between two positions are computed from the commands
sent to the robot, as in the paper; odometry is not read.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.agent.pose.odometry import impossible
from formation.agent.pose.pose_update import PoseUpdate
from formation.control.observer import Travel
from formation.control.plane import angle_between, rotation
from formation.control.unicycle import Command
from formation.mission.model import Mission
from formation.protocol.reasons import Reason
from formation.protocol.status import Localised
from formation.ros2.messages import Pose

HISTORY_TIME = 5.0
"""Age after which commands are forgotten [s]."""
COASTING_TIME = 0.5
"""Approximate time that a robot moves on after its agent's death [s]."""


class Sent(NamedTuple):
    """A command and when it was sent [s, monotonic]; it holds until the next."""

    since: float
    command: Command


@dataclass(slots=True, kw_only=True)
class ExternalPoseState:
    """The newest external pose, and the commands since."""

    last: Pose | None = None
    """The newest message; None before the first."""
    sent: deque[Sent] = field(default_factory=deque)
    """The commands of the last `HISTORY_TIME` seconds, oldest first."""


class ExternalPoseSource:
    """The external poses of one robot."""

    name = "pose"
    alignment = Localised.EXTERNAL
    doubt: Reason | None = None
    realigned = 0
    realigned_after: Reason | None = None

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self._limits = spec.limits
        self._reads_heading = spec.heading == "measured"
        self.state = ExternalPoseState()

    def commanded(self, moment: float, command: Command) -> None:
        """Record that the robot was sent `command` at `moment` [s, monotonic]."""
        while len(self.state.sent) > 1 and self.state.sent[1].since < moment - HISTORY_TIME:
            self.state.sent.popleft()
        if not self.state.sent or self.state.sent[-1].command != command:
            self.state.sent.append(Sent(moment, command))

    def unlike(self, pose: Pose, over: float) -> str | None:
        """Why the robot's turn in the `over` [s] since the newest position is unknown, in words.

        It was sent no commands since: a robot that moved was carried, or drove on without being stopped.
        """
        if self.state.last is None:
            return "it had not been seen"
        moved, over = abs(pose.position - self.state.last.position), min(over, COASTING_TIME)
        jumped = impossible(self.name, moved, 0.0, self._limits, over)
        return None if jumped is None else f"{jumped} while no agent drove the robot"

    def stood(self, since: float) -> None:
        """Assume that the robot has stood since then [s, monotonic]: the agent that drove it has ended."""
        self.state.sent = deque([Sent(since, Command(0.0, 0.0))])

    def make_update(self, pose: Pose, over: float | None, moment: float) -> PoseUpdate:
        """The update for a pose at `moment` [s, monotonic], `over` [s] after the one before."""
        last, self.state.last = self.state.last, pose
        if last is None or over is None:
            return PoseUpdate(pose.position, pose.heading, None)
        distance, turn = self._driven(moment - over, moment)
        moved, seen_turn = pose.position - last.position, 0.0
        if self._reads_heading:  # it also shows turns by hand
            turn = seen_turn = float(angle_between(last.heading, pose.heading))
        jumped = impossible(self.name, abs(moved), seen_turn, self._limits, over)
        return PoseUpdate(pose.position, pose.heading, Travel(distance, turn, moved), jumped, rotation(turn))

    def _driven(self, start: float, end: float) -> tuple[float, float]:
        """Path length [m] and turn [rad] of the commands in this time."""
        distance, turn, until = 0.0, 0.0, end
        for since, command in reversed(self.state.sent):
            if until <= start:
                break
            held = max(0.0, until - max(since, start))
            distance += command.speed * held
            turn += command.turn_rate * held
            until = min(until, since)
        return distance, turn
