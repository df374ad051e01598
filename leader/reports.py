"""What a candidate reports: replies to an operator's requests, and its status.

Every candidate obeys requests that change motion; only the leader obeys the others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from formation.leader.plan import Plan
from formation.protocol import json_message
from formation.protocol.addressed import Addressee
from formation.protocol.attachment import mixed
from formation.protocol.election import REPORT_TIME, CandidacyState
from formation.protocol.order import Mode
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorReply, OperatorRequest, ReplyCode, shortened
from formation.protocol.status import AnsweredRequest, LeaderState, LeaderStatus
from formation.protocol.stops import Once, Result
from formation.wire import Now

if TYPE_CHECKING:
    from formation.leader.core import Leader

STATUS_REPEATS = 3
"""Number of statuses after the first that repeat an operator's request."""
MAX_NOTES = 64
"""Number of notes kept for the log."""


class Leadership(NamedTuple):
    """Whether this candidate leads, and what it knows of the leader."""

    candidacy: CandidacyState
    leader: str
    """The leading candidate, as far as known; empty if there is none."""
    mode: Mode
    """The fleet's mode, as far as known."""

    @property
    def leads(self) -> bool:
        """Whether this candidate is the leader."""
        return self.candidacy == "leader"


class OperatorRequests:
    """Operator requests of one candidate."""

    def __init__(
        self, name: str, plan: Plan, lead: Callable[[], Leadership], addressee: Addressee, *, alone: bool
    ) -> None:
        """`alone`: it is the only candidate and will lead."""
        self.unpublished = False
        """Whether the last request is in no status yet."""
        self.notes: deque[str] = deque(maxlen=MAX_NOTES)
        """What has changed, for the log."""
        self._name, self._plan, self._lead, self._alone = name, plan, lead, alone
        self._addressee = addressee
        self._once = Once()
        self._requests: list[tuple[AnsweredRequest, int]] = []  # recent ones, with their number of statuses

    def note_restart(self, mono: float) -> None:
        """Note that it began to lead, restored an order or was suspended, at `mono` [s].

        A request to run from before a stop or a hold that is then in force no longer counts.
        """
        if self._plan.team_mode.rest.stop or self._plan.team_mode.hold:
            self._once.rest(mono)

    def answer(self, request: OperatorRequest, received: float) -> bytes:
        """Return the reply to a request, which takes effect with the next step; `received` [s, monotonic]."""
        return self._addressee.answer(
            request, lambda: self._answer_here(request, received), lambda: self.reply(ok=False)
        )

    def _answer_here(self, request: OperatorRequest, received: float) -> bytes:
        """Return the reply to a request for this mission, or for any."""
        if request.do == "query":
            mode = self._plan.team_mode
            return self.reply(ok=True, stop=mode.rest.stop, hold=mode.hold)
        why = self._why_not_here(request)
        if why:
            return self.reply(ok=False, reason=why)
        if request.do == "drive":
            ok, reason, code = self._plan.drive(request, received)
            return self.reply(ok=ok, reason=reason, code=code, token=self._plan.driver.token(received))
        if request.do == "run" and not self._lead().leads and self._lead().candidacy != "listening":
            # not remembered: at the next repetition it may lead, and must then obey
            return self._reply_to(self._plan.team_mode.change(request, "", leads=False))
        answer = self._once.answer(
            request,
            received,
            lambda: self._obey(request, received),
            lambda reason: self._note(request, Result(ok=False, reason=reason)),
        )
        # a repeated request is answered with whether it leads by now
        known = json_message.decode(OperatorReply, answer)
        return json_message.encode(known.model_copy(update={"leads": self._lead().leads}))

    def requests(self) -> tuple[AnsweredRequest, ...]:
        """Return the requests for the next status; each stays for `STATUS_REPEATS` more."""
        self.unpublished, requests = False, self._requests
        self._requests = [(one, times + 1) for one, times in requests if times < STATUS_REPEATS]
        return tuple(one for one, _ in requests)

    def reply(
        self, *, ok: bool, reason: str = "", code: ReplyCode = "", stop: str = "", hold: str = "",
        token: int = 0,
    ) -> bytes:  # fmt: skip
        """Return the reply, encoded."""
        lead = self._lead()
        return json_message.encode(
            OperatorReply(
                robot=self._name,
                ok=ok,
                mode=lead.mode,
                reason=shortened(reason),
                leads=lead.leads,
                code=code,
                stop=stop,
                hold=hold,
                token=token,
            )
        )

    def _reply_to(self, result: Result) -> bytes:
        return self.reply(ok=result.ok, reason=result.reason, code=result.code)

    def _why_not_here(self, request: OperatorRequest) -> str:
        """Return why the request must go to another candidate: a standby takes only what changes motion."""
        lead = self._lead()
        if lead.leads or request.do in {"stop", "hold", "release"}:
            return ""
        if lead.candidacy == "listening":
            mine = self._alone and request.do == "run"
            return "" if mine else "has just started: ask again in a second"
        if request.do == "run":
            return ""
        return f"stands by; {lead.leader} leads" if lead.leader else "stands by; no candidate leads yet"

    def _obey(self, request: OperatorRequest, received: float) -> bytes:
        mode = self._lead().mode
        result = self._plan.obey(request, self._once.rest_id(request, received), received)
        if result.ok:
            now = self._lead().mode
            change = f"{mode} to {now}" if mode != now else result.reason or now
            self.notes.append(f"the operator asked for {request.do}: {change}")
        return self._note(request, result)

    def _note(self, request: OperatorRequest, result: Result) -> bytes:
        """Return the reply. The request and its result go into a status at once."""
        self._requests.append((AnsweredRequest(request, result.ok, result.reason), 0))
        self.unpublished = True
        return self._reply_to(result)


def status(leader: Leader, now: Now, ends: str) -> LeaderStatus:
    """Return the status; `ends` says why the process ends, empty if it does not."""
    lead, plan, forgers = leader.leadership, leader.plan, leader.forgers(now.mono)
    term = leader.term if leader.leads else leader.known
    refusals = leader.candidacy.refusals(now.mono)
    others = {robot: tag for robot, (tag, when) in leader.mixed.items() if now.mono - when <= REPORT_TIME}
    if ends:
        reason: Reason | None = Reason.of(Code.ENDED, cause=ends)
    elif others:
        reason = mixed(*next(iter(others.items())), leader.mission.tag)
    elif refusals:
        code = Code.TERM_AHEAD if "ahead" in refusals.values() else Code.TERM_EARLIER
        reason = Reason.of(code, robots=tuple(refusals), term=term)
    else:
        reason = _standing_reason(plan) if lead.leads else _standby_reason(leader)
    return LeaderStatus(
        robot=leader.name,
        state=LeaderState(lead.mode if lead.leads else lead.candidacy),
        reason=reason,
        leads=lead.leads,
        leader=lead.leader,
        term=term,
        mission=leader.mission.fingerprint,
        requests=leader.operator_requests.requests(),
        refused_by=refusals,
        other_mission=others,
        forged={robot: why for robot, (_, why) in forgers.items()},
        forged_count={robot: count for robot, (count, _) in forgers.items()},
        dropped=leader.dropped,
        **(_leader_fields(leader) if lead.leads else _latch_fields(plan)),
    )


def _standing_reason(plan: Plan) -> Reason | None:
    """What keeps the leader from going on; None if nothing does."""
    if plan.team_mode.lost:
        return plan.team_mode.lost
    if plan.team_mode.unread:
        return Reason(Code.ORDER_UNREAD)
    if plan.team_mode.undriven:
        return Reason(Code.NOT_DRIVEN)
    if (breach := plan.fenced) is not None:
        return Reason.of(
            Code.STOPPED_AT_BOUNDS, what=breach.what, axis=breach.axis, value=breach.value, limit=breach.limit
        )
    if plan.waits_for:
        return Reason.of(Code.WAITS, robots=plan.waits_for)
    return Reason(Code.ROUTE_ENDED) if plan.route_time >= plan.route.total else None


def _standby_reason(leader: Leader) -> Reason | None:
    lead = leader.leadership
    if lead.candidacy == "listening" and not leader.candidacy.has_received:
        return Reason(Code.NO_ROBOT)
    if lead.candidacy != "standby":
        return None
    return Reason.of(Code.OTHER_LEADS, robot=lead.leader) if lead.leader else Reason(Code.NO_LEADER)


def _leader_fields(leader: Leader) -> dict[str, Any]:
    plan = leader.plan
    placed_shape, gains = plan.shape_transition.placed_shape, plan.gains
    return {
        "at_bounds": plan.fenced is not None,
        "waits_for": plan.waits_for,
        "shape": plan.shape_transition.ordered.shape,
        "share": {shape: round(share, 4) for shape, share in placed_shape.mix if share > 0.0},
        "rotation": round(placed_shape.rotation, 6),
        "scale": round(placed_shape.scale, 6),
        "changing": round(plan.shape_transition.remaining, 1),
        "k_p": gains.k_p,
        "k_i": gains.k_i,
        "route": plan.route.id,
        "route_time": round(plan.route_time, 3),
        "pace": round(plan.pace, 2),
        "beat": leader.beat,
        "late": leader.rate.missed,
    }


def _latch_fields(plan: Plan) -> dict[str, Any]:
    """The stop or the hold that a candidate keeps while another leads."""
    mode = plan.team_mode.rest.mode
    return {"latched": LeaderState(mode)} if mode else {}
