"""What this robot attaches to its positions besides orders and votes: answers, and whether it is available.

Answers bound the age of other robots' positions by round trips, whatever their clocks say. Each position
names the newest position that its sender has received from one other robot, from each in turn. A message that
names a position which this robot sent within the bound was sent after that position, so it is younger than
the bound. Stamps alone cannot distinguish a wrong clock from late messages.

A robot becomes unavailable, so that others follow other robots, when it does not drive for a reason of its
own, until it is near its slot again or has driven towards it for `FAULT_FREE_TIME`. All robots are available
when a fleet sets out; a robot that joins a moving fleet starts unavailable. Nothing is reported while the
leader orders no motion.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from formation.agent.following.neighbour import Neighbour
from formation.agent.pose.estimator import START_HEADING_TIME
from formation.agent.safety.failsafe import Decision
from formation.control.tracker import longest_delay
from formation.mission.model import Mission
from formation.protocol.attachment import ReceivedPosition
from formation.protocol.order import Order
from formation.protocol.status import AgentState

MAX_ANSWER_DELAYS = 3.0
"""A message answers if the position that it names was sent at most this long before [longest delays]."""
STAMP_TOLERANCE = 1e-6
"""Stamps that differ by less are equal: messages carry nanoseconds, this process floats [s]."""
FOLLOWING_EDGE_ERROR = 0.05
"""Edge error below which a robot counts as following again [m]."""
FAULT_FREE_TIME = 10.0
"""Driving time without a fault after which a robot counts as following again [s]."""


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


@dataclass(slots=True)
class Availability:
    """Whether one robot is unavailable."""

    published: bool = False
    """Whether its positions report it as unavailable."""
    behind: bool = False
    """Whether it is unavailable, or would be if the leader ordered motion."""
    set_out: bool = False
    """Whether it has driven under an order."""
    since: float = 0.0
    """Time of its newest fault [s, monotonic]."""
    error: float = float("inf")
    """Newest mean edge error [m]."""

    def judge(self, decision: Decision, order: Order | None, moment: float) -> None:
        """Update from the decision at `moment` [s, monotonic] under the newest order."""
        wanted = order is not None and order.mode == "run"
        if not self.set_out and decision.state is AgentState.RUN and order is not None:
            self.set_out, self.behind, self.since = True, order.time > START_HEADING_TIME, moment
        if self.set_out and wanted and decision.own:
            self.behind, self.since, self.error = True, moment, float("inf")
        elif self.behind and decision.state is AgentState.RUN:
            self.behind = self.error > FOLLOWING_EDGE_ERROR and moment - self.since < FAULT_FREE_TIME
        self.published = self.behind and wanted
