"""What an operator asked of this very robot: a stop or a hold that stays until it is ended by its id.

It outlives its process where `agent.survival` keeps it.
"""

from __future__ import annotations

from formation import order
from formation.once import RESTS, Once
from formation.order import Code, Mode, OperatorReply, OperatorRequest, shortened
from formation.rest import MOTION, Rest

HALTED = "halted"
"""Id of the stop that an agent which ends leaves behind in its own memory."""


class Latch:
    """The stop and the hold of one robot."""

    def __init__(self, robot: str) -> None:
        self.rest = Rest()
        """What is in force."""
        self.why = ""
        """Why, where nobody asked that of this very process."""
        self._robot = robot
        self.once = Once()
        """Which requests are known."""

    @property
    def mode(self) -> Mode | None:
        """What is in force, a stop before a hold; None for neither."""
        return self.rest.mode

    def ask(self, request: OperatorRequest, heard: float, ordered: Mode, unreached: Code = "") -> bytes:
        """Answer a request that came at `heard` [s, monotonic]; `ordered` is what the leader wants.

        `unreached` says why no command reaches the robot: a stop or a hold is latched, and answered with that
        instead of a yes, each time anew.
        """
        if request.do == "query":
            return self.reply(ordered, ok=True, stop=self.rest.stop, hold=self.rest.hold)
        answer = self.once.answer(
            request,
            heard,
            lambda: self._obey(request, heard, ordered),
            lambda reason: self.reply(ordered, ok=False, reason=reason),
        )
        if unreached and request.do in RESTS:
            return self.reply(ordered, ok=False, code=unreached, reason=f"latched, but {WHY[unreached]}")
        return answer

    def _obey(self, request: OperatorRequest, heard: float, ordered: Mode) -> bytes:
        if request.do not in MOTION:
            return self.reply(ordered, ok=False, reason=f"{request.do}: that is the leader's to say")
        before = self.mode
        result = self.rest.change(request, self.once.fact(request, heard))
        if self.mode != before or self.mode == request.do:
            self.why = ""
        return self.reply(ordered, ok=result.ok, code=result.code, reason=result.reason)

    def reply(
        self,
        ordered: Mode,
        *,
        ok: bool,
        reason: str = "",
        code: Code = "",
        stop: str = "",
        hold: str = "",
    ) -> bytes:
        """What the operator gets to read."""
        return order.encode(
            OperatorReply(
                robot=self._robot,
                ok=ok,
                mode=self.mode or ordered,
                reason=shortened(reason),
                code=code,
                stop=stop,
                hold=hold,
            )
        )


WHY = {
    "no-link": "the agent has no link to the robot",
    "no-listener": "nobody listens on cmd_vel",
    "readonly": "the agent is readonly: it does not command the robot",
}
"""Why no command reaches the robot, in words."""
