"""Does this robot follow? Who does not says so with its positions, and others go on without it.

It is aside from when it does not drive for a reason of its own, until it is near its slot again, or
has been on its way there for a good while. When a team sets out nobody is aside, but who joins one that is
under way begins so. It is not said while the leader wants nobody to drive: then nobody needs another guide.
"""

from __future__ import annotations

from agent.failsafe import Decision, State
from agent.localisation import UNDER_WAY
from formation.order import Order

NEAR = 0.05
"""Who is no further from its slot, by its neighbours, follows again [m]."""
PATIENCE = 10.0
"""Who has driven for so long without a fault is as near as it gets [s]."""


class Aside:
    """Whether one robot is aside."""

    def __init__(self) -> None:
        self.told = False
        """Whether the others are to go on without it."""
        self.behind = False
        """Whether it is aside or would be, but for the leader's orders."""
        self._set_out = False
        self._since = 0.0  # of its newest fault [s, monotonic]
        self._error = float("inf")

    def drove(self, error: float) -> None:
        """It drives, and its mean edge error is this [m]."""
        self._error = error

    def judge(self, decision: Decision, order: Order | None, moment: float) -> None:
        """Learn what was decided at `moment` [s, monotonic] under the newest order."""
        wanted = order is not None and order.mode == "run"
        if not self._set_out and decision.state is State.RUN and order is not None:
            self._set_out, self.behind, self._since = True, order.time > UNDER_WAY, moment
        if self._set_out and wanted and decision.own:
            self.behind, self._since, self._error = True, moment, float("inf")
        elif self.behind and decision.state is State.RUN:
            self.behind = self._error > NEAR and moment - self._since < PATIENCE
        self.told = self.behind and wanted
