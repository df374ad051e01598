"""Answers an operator's requests: those that change motion at each candidate, the others where it leads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from formation import order
from formation.election import Standing
from formation.once import Once
from formation.order import Code, Mode, OperatorReply, OperatorRequest
from formation.rest import Result
from leader.conduct import Conduct

TOLD = 3
"""In so many statuses more than the first stands what an operator has asked for."""
NOTES = 64
"""So many are kept for whoever writes them down."""


class Seat(NamedTuple):
    """How the one who is asked stands."""

    standing: Standing
    leader: str
    """Who leads, as far as is known; empty for nobody."""
    mode: Mode
    """Of the team, as far as is known."""

    @property
    def leads(self) -> bool:
        """Whether that is who is asked."""
        return self.standing == "leader"


class Asked(NamedTuple):
    """What an operator asked for, and what was answered."""

    request: OperatorRequest
    ok: bool
    reason: str
    told: int = 0
    """In so many statuses that has stood."""


class Desk:
    """Answers for one candidate."""

    def __init__(self, name: str, conduct: Conduct, seat: Callable[[], Seat], *, alone: bool) -> None:
        """`alone`: it is the only candidate, and so will lead."""
        self.unsaid = False
        """Whether what was asked last is in no status yet."""
        self.notes: deque[str] = deque(maxlen=NOTES)
        """What has changed, for people."""
        self._name, self._conduct, self._seat, self._alone = name, conduct, seat, alone
        self._once = Once()
        self._asked: list[Asked] = []  # of late

    def goes_on(self, mono: float) -> None:
        """It goes on, at `mono` [s], with what another was told.

        Who asked to run before a stop of then did not mean now.
        """
        if self._conduct.will.rest.mode:
            self._once.rest(mono)

    def answer(self, request: OperatorRequest, heard: float) -> bytes:
        """The reply to what came at `heard` [s, monotonic]; what is asked takes effect with the next step."""
        rest = self._conduct.will.rest
        if request.do == "query":
            return self.reply(ok=True, stop=rest.stop, hold=rest.hold)
        why = self._not_mine(request)
        if why:
            return self.reply(ok=False, reason=why)
        if request.do == "run" and not self._seat().leads and self._seat().standing != "listening":
            # it may lead by the next repetition, which is then another request
            return self._answered(self._conduct.will.change(request, "", leads=False))
        answer = self._once.answer(
            request,
            heard,
            lambda: self._obey(request, heard),
            lambda reason: self._note(request, Result(ok=False, reason=reason)),
        )
        # who asks again and again wants to know whether it leads by now
        known = order.decode(OperatorReply, answer)
        return order.encode(known.model_copy(update={"leads": self._seat().leads}))

    def asked(self) -> list[Asked]:
        """What the next status is to say of it, in this and in some more."""
        self.unsaid, asked = False, self._asked
        self._asked = [one._replace(told=one.told + 1) for one in asked if one.told < TOLD]
        return asked

    def reply(self, *, ok: bool, reason: str = "", code: Code = "", stop: str = "", hold: str = "") -> bytes:
        """What the operator gets to read."""
        seat = self._seat()
        return order.encode(
            OperatorReply(
                robot=self._name,
                ok=ok,
                mode=seat.mode,
                reason=order.shortened(reason),
                leads=seat.leads,
                code=code,
                stop=stop,
                hold=hold,
            )
        )

    def _answered(self, result: Result) -> bytes:
        return self.reply(ok=result.ok, reason=result.reason, code=result.code)

    def _not_mine(self, request: OperatorRequest) -> str:
        """Why another candidate is to be asked: a standby takes what changes motion, and nothing else."""
        seat = self._seat()
        if seat.leads or request.do in {"stop", "hold", "release"}:
            return ""
        if seat.standing == "listening":
            mine = self._alone and request.do == "run"
            return "" if mine else "has just started: ask again in a second"
        if request.do == "run":
            return ""
        return f"stands by; {seat.leader} leads" if seat.leader else "stands by; nobody leads yet"

    def _obey(self, request: OperatorRequest, heard: float) -> bytes:
        mode = self._seat().mode
        result = self._conduct.obey(request, self._once.fact(request, heard))
        if result.ok:
            now = self._seat().mode
            change = f"{mode} to {now}" if mode != now else result.reason or now
            self.notes.append(f"the operator asked for {request.do}: {change}")
        return self._note(request, result)

    def _note(self, request: OperatorRequest, result: Result) -> bytes:
        """The reply. What was asked, and what was answered, is to be said in a status at once."""
        self._asked.append(Asked(request, result.ok, result.reason))
        self.unsaid = True
        return self._answered(result)
