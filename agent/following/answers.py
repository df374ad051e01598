"""Bound the age of other robots' positions by round trips, whatever their clocks say.

Each position names the newest position that its sender has received from one other robot, from each in turn.
A message that names a position which this robot sent within the bound was sent after that position, so it is
younger than the bound. Stamps alone cannot distinguish a wrong clock from late messages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from formation.agent.following.neighbours import Neighbour
from formation.control.tracker import longest_delay
from formation.mission.model import Mission
from formation.protocol.order import ReceivedPosition

MAX_ANSWER_DELAYS = 3.0
"""A message answers if the position that it names was sent at most this long before [longest delays]."""
STAMP_TOLERANCE = 1e-6
"""Stamps that differ by less are equal: messages carry nanoseconds, this process floats [s]."""


@dataclass(slots=True, kw_only=True)
class AnswersState:
    """The recently sent positions, and which robot was named last."""

    sent: deque[tuple[float, float]] = field(default_factory=deque)
    """Stamps [s], and when they were sent [s, monotonic]."""
    turn: int = 0
    """Index of the robot that was named last."""


class Answers:
    """The recently sent positions of this robot, and the answers to them."""

    def __init__(self, mission: Mission, robot: str, each: Iterable[Neighbour]) -> None:
        """`each`: the neighbours, and the robots that only the collision filter uses."""
        self._robot = robot
        self._others = {one.name: one for one in each if one.answers}
        slowest = min(mission.robots[name].rate for name in mission.followers)
        self._longest = MAX_ANSWER_DELAYS * longest_delay(slowest)
        self.state = AnswersState()

    def record_sent(self, stamp: float, mono: float) -> None:
        """Record that the position with this `stamp` [s] is sent now."""
        self.state.sent.append((stamp, mono))
        while self.state.sent[0][1] < mono - self._longest:
            self.state.sent.popleft()

    def next_named(self) -> ReceivedPosition | None:
        """Return what the next position is to name; None if no robot has been received."""
        received = [one for one in self._others.values() if one.stream.state.arrived is not None]
        if not received:
            return None
        self.state.turn = (self.state.turn + 1) % len(received)
        return ReceivedPosition(
            robot=received[self.state.turn].name, stamp=received[self.state.turn].stream.state.stamp
        )

    def answered(self, name: str, received: ReceivedPosition | None, arrived: float) -> bool:
        """Whether a message of `name`, `arrived` [s, monotonic], names a recent position of this robot."""
        if received is None or received.robot != self._robot or name not in self._others:
            return False
        since = arrived - MAX_ANSWER_DELAYS * self._others[name].stream.longest_delay
        return any(
            abs(stamp - received.stamp) < STAMP_TOLERANCE and mono >= since for stamp, mono in self.state.sent
        )
