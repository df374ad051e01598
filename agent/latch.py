"""What an operator asked of this very robot: a stop or a hold that stays until it is released.

It outlives its process where `agent.survival` keeps it.
"""

from __future__ import annotations

from formation import order
from formation.once import Once
from formation.order import LONGEST_REASON, Do, Mode, OperatorReply, OperatorRequest

MINE = frozenset({"stop", "hold", "run", "release"})
"""What a robot itself may be asked for."""


class Latch:
    """What stays in force until the operator releases it."""

    def __init__(self, robot: str) -> None:
        self.mode: Mode | None = None
        """``stop`` or ``hold`` until released; None when there is nothing to release."""
        self.why = ""
        """Why, where nobody asked that of this very process."""
        self._robot = robot
        self.once = Once()
        """Which requests are known."""

    def ask(self, data: bytes, heard: float, ordered: Mode) -> bytes:
        """Answer a request that came at `heard` [s, monotonic]; `ordered` is what the leader wants.

        Raises BadMessage for what is no request.
        """
        request = order.decode(OperatorRequest, data)
        return self.once.answer(
            request,
            heard,
            lambda: self._obey(request.do, ordered),
            lambda reason: self.reply(ordered, ok=False, reason=reason),
        )

    def _obey(self, wanted: Do, ordered: Mode) -> bytes:
        if wanted not in MINE:
            return self.reply(ordered, ok=False, reason=f"{wanted}: that is the leader's to say")
        if self.mode == "stop" and wanted in {"run", "hold"}:
            return self.reply(ordered, ok=False, reason="stopped: release it first")
        self.mode, self.why = wanted if wanted in {"stop", "hold"} else None, ""
        return self.reply(ordered, ok=True, reason="")

    def reply(self, ordered: Mode, *, ok: bool, reason: str) -> bytes:
        """What the operator gets to read."""
        mode = self.mode or ordered
        return order.encode(
            OperatorReply(robot=self._robot, ok=ok, mode=mode, reason=reason[:LONGEST_REASON])
        )
