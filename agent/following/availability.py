"""Whether this robot is unavailable, as its positions tell, so that others follow other robots.

It becomes unavailable when it does not drive for a reason of its own, until it is near its slot again or has
driven towards it for `FAULT_FREE_TIME`. All robots are available when a team sets out; a robot that joins a
moving team starts unavailable. Nothing is reported while the leader orders no motion.
"""

from __future__ import annotations

from dataclasses import dataclass

from formation.agent.pose.estimator import START_HEADING_TIME
from formation.agent.safety.failsafe import Decision
from formation.protocol.order import Order
from formation.protocol.status import AgentState

FOLLOWING_EDGE_ERROR = 0.05
"""Edge error below which a robot counts as following again [m]."""
FAULT_FREE_TIME = 10.0
"""Driving time without a fault after which a robot counts as following again [s]."""


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

    def drove(self, error: float) -> None:
        """Store the mean edge error [m] of a driving robot."""
        self.error = error

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
