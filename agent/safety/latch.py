"""An operator's request to this robot: a stop or a hold that lasts until it is released by its id.

It outlives its process where `formation.agent.persistence.restore` saves it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from formation.protocol import json_message
from formation.protocol.order import Mode
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorReply, OperatorRequest, ReplyCode, shortened
from formation.protocol.stops import MOTION, RESTS, Once, Rest

HALTED = "halted"
"""Id of the stop that an ending agent leaves in its own state."""


@dataclass(slots=True, kw_only=True)
class LatchState:
    """What is latched."""

    rest: Rest = field(default_factory=Rest)
    """What is in force."""
    stop_reason: Reason | None = None
    """Why it is stopped, unless an operator asked this process for it."""
    hold_reason: Reason | None = None
    """Why it is held, also below a stop, unless an operator asked this process for it."""
    once: Once = field(default_factory=Once)
    """The requests that are known."""

    @property
    def why(self) -> Reason | None:
        """The reason of what is in force, unless an operator asked this process for it."""
        mode = self.rest.mode
        return self.stop_reason if mode == "stop" else self.hold_reason if mode == "hold" else None


class Latch:
    """The stop and the hold of one robot."""

    def __init__(self, robot: str, *, readonly: bool = False) -> None:
        """`readonly`: the agent does not command the robot, and its answers say so."""
        self.state = LatchState()
        self._robot, self._readonly = robot, readonly

    @property
    def mode(self) -> Mode | None:
        """What is in force, a stop before a hold; None for neither."""
        return self.state.rest.mode

    def request(
        self, request: OperatorRequest, received: float, ordered: Mode, unreached: ReplyCode = ""
    ) -> bytes:
        """Answer a request received at `received` [s, monotonic]; `ordered` is the leader's mode.

        `unreached` says why no command reaches the robot: a stop or a hold is latched, and answered with
        that instead of a yes, each time anew.
        """
        if request.do == "query":
            return self.reply(ordered, ok=True, stop=self.state.rest.stop, hold=self.state.rest.hold)
        answer = self.state.once.answer(
            request,
            received,
            lambda: self._obey(request, received, ordered),
            lambda reason: self.reply(ordered, ok=False, reason=reason),
        )
        if unreached and request.do in RESTS:
            return self.reply(ordered, ok=False, code=unreached, reason=f"latched, but {WHY[unreached]}")
        return answer

    def _obey(self, request: OperatorRequest, received: float, ordered: Mode) -> bytes:
        if request.do not in MOTION:
            return self.reply(ordered, ok=False, reason=f"{request.do}: that is the leader's to say")
        state, before = self.state, replace(self.state.rest)
        rest_id = state.once.rest_id(request, received)
        result = state.rest.change(request, f"at-{received:.6f}" if rest_id == HALTED else rest_id)
        if state.rest.stop != before.stop:
            state.stop_reason = None
        # an operator's hold does not settle the doubt for which the agent holds the robot
        if state.rest.hold != before.hold and not (state.rest.hold and is_own(state.hold_reason)):
            state.hold_reason = None
        return self.reply(ordered, ok=result.ok, code=result.code, reason=result.reason)

    def reply(
        self,
        ordered: Mode,
        *,
        ok: bool,
        reason: str = "",
        code: ReplyCode = "",
        stop: str = "",
        hold: str = "",
    ) -> bytes:
        """Encode the operator's answer."""
        return json_message.encode(
            OperatorReply(
                robot=self._robot,
                ok=ok,
                mode=self.mode or ordered,
                reason=shortened(reason),
                code=code,
                stop=stop,
                hold=hold,
                readonly=self._readonly,
            )
        )


def is_own(reason: Reason | None) -> bool:
    """Whether an agent rests by itself for that `reason`, and by no operator's request."""
    return reason is not None and reason.code not in {Code.STOPPED_BEFORE_START, Code.HELD_BEFORE_START}


WHY = {
    "no-link": "the agent has no link to the robot",
    "no-listener": "nothing listens on cmd_vel",
    "readonly": "the agent is readonly: it does not command the robot",
}
"""Why no command reaches the robot, in words."""
