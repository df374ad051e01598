"""What an operator asked of this very robot: a stop or a hold that stays until it is released.

It outlives its process where `agent.survival` keeps it.
"""

from __future__ import annotations

from formation import order
from formation.once import Once
from formation.order import Do, Mode, OperatorReply, OperatorRequest, shortened

MINE = frozenset({"stop", "hold", "run", "release"})
"""What a robot itself may be asked for."""


class Latch:
    """What stays in force until the operator releases it."""

    def __init__(self, robot: str) -> None:
        self.stopped = False
        """Until it is released."""
        self.holding = False
        """Until it is released, which a stop's release does not do, or told to run."""
        self.why = ""
        """Why, where nobody asked that of this very process."""
        self._robot = robot
        self.once = Once()
        """Which requests are known."""

    @property
    def mode(self) -> Mode | None:
        """What is in force, a stop before a hold; None when there is nothing to release."""
        return "stop" if self.stopped else "hold" if self.holding else None

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
        if wanted == "run" and self.stopped:
            return self.reply(ordered, ok=False, reason="stopped: release it first")
        before = self.mode
        if wanted == "stop":
            self.stopped = True
        elif wanted == "hold":
            self.holding = True
        elif self.stopped:  # to be released; a hold below it stays, as the leader's does
            self.stopped = False
        else:
            self.holding = False
        if self.mode != before or self.mode == wanted:
            self.why = ""
        return self.reply(ordered, ok=True, reason="")

    def reply(self, ordered: Mode, *, ok: bool, reason: str) -> bytes:
        """What the operator gets to read."""
        mode = self.mode or ordered
        return order.encode(OperatorReply(robot=self._robot, ok=ok, mode=mode, reason=shortened(reason)))
