"""Does this robot follow? Who does not says so with its positions, and others go on without it.

It is aside from when it does not drive for a reason of its own, or drives and gets nowhere, until it is near
its slot again, or has been on its way there for a good while. When a team sets out nobody is aside, but who
joins one that is under way begins so. It is not said while the leader wants nobody to drive: then nobody
needs another guide.
"""

from __future__ import annotations

from agent.failsafe import Decision, State
from agent.localisation import UNDER_WAY
from formation.law import Limits
from formation.order import Order
from formation.unicycle import Command, body_velocity

NEAR = 0.05
"""Who is no further from its slot, by its neighbours, follows again [m]."""
PATIENCE = 10.0
"""Who has driven for so long without a fault is as near as it gets [s]."""
STUCK = 1.5
"""Who was told to move for so long, and did not, is stuck [s]."""
SLOW = 0.1
"""Share of its top speed below which a command says too little of whether a robot moves."""
MOVED, TURNED = 0.02, 0.2
"""So far a robot that stands may seem to move, and to turn [m; –]."""
SLIPPED = 0.25
"""Share of the way that was asked of it below which a robot does not move."""


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

    def judge(self, decision: Decision, order: Order | None, moment: float, *, stuck: bool) -> None:
        """Learn what was decided at `moment` [s, monotonic] under the newest order."""
        wanted = order is not None and order.mode == "run"
        if not self._set_out and decision.state is State.RUN and order is not None:
            self._set_out, self.behind, self._since = True, order.time > UNDER_WAY, moment
        if self._set_out and wanted and (decision.own or stuck):
            self.behind, self._since, self._error = True, moment, float("inf")
        elif self.behind and decision.state is State.RUN:
            self.behind = self._error > NEAR and moment - self._since < PATIENCE
        self.told = self.behind and wanted


class Stuck:
    """Whether a robot that is told to move does not."""

    def __init__(self, limits: Limits) -> None:
        self.now = False
        """Whether it has not moved for a while though it was told to."""
        self._offset, self._slow = limits.offset, SLOW * limits.max_speed
        self._anchor: tuple[complex, complex] = 0j, 0j  # its control point and heading when it moved last
        self._way = 0.0  # of its control point since then, by its commands [m]
        self._lasts = 0.0  # [s]

    def drove(self, command: Command, point: complex, heading: complex, over: float) -> None:
        """It was told `command` for the last `over` [s], and is now here."""
        speed = abs(body_velocity(command.speed, command.turn_rate, self._offset))
        before, facing = self._anchor
        moved = abs(point - before) > MOVED + SLIPPED * self._way or abs(heading - facing) > TURNED
        if speed < self._slow or moved:
            self.rested()
            self._anchor = point, heading
            return
        self._way += speed * over
        self._lasts += over
        self.now = self._lasts >= STUCK

    def rested(self) -> None:
        """It was not told to move."""
        self.now, self._way, self._lasts = False, 0.0, 0.0
