"""Compose a candidate's status."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from formation.leader.operator_requests import Seat
from formation.leader.plan import Plan
from formation.protocol.election import REPORT_TIME
from formation.protocol.order import mixed
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import LeaderState, LeaderStatus
from formation.wire import Now

if TYPE_CHECKING:
    from formation.leader.core import Leader


def status(leader: Leader, now: Now, ends: str = "") -> LeaderStatus:
    """Return the status; `ends` says why the process ends, if it does."""
    seat, plan, forgers = leader.seat, leader.plan, leader.forgers(now.mono)
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
        reason = _why(plan) if seat.leads else _why_not(seat)
    return LeaderStatus(
        robot=leader.name,
        state=LeaderState(seat.mode if seat.leads else seat.candidacy),
        reason=reason,
        leads=seat.leads,
        leader=seat.leader,
        term=term,
        mission=leader.mission.fingerprint,
        requests=leader.operator_requests.requests(),
        refused_by=refusals,
        other_mission=others,
        forged={robot: why for robot, (_, why) in forgers.items()},
        forged_count={robot: count for robot, (count, _) in forgers.items()},
        dropped=leader.dropped,
        **(_leading(leader) if seat.leads else _latched(plan)),
    )


def _why(plan: Plan) -> Reason | None:
    """What keeps the leader from going on; None if nothing does."""
    if plan.team_mode.lost:
        return plan.team_mode.lost
    if (breach := plan.fenced) is not None:
        return Reason.of(
            Code.STOPPED_AT_BOUNDS, what=breach.what, axis=breach.axis, value=breach.value, limit=breach.limit
        )
    if plan.waits_for:
        return Reason.of(Code.WAITS, robots=plan.waits_for)
    return Reason(Code.ROUTE_ENDED) if plan.route_time >= plan.route.total else None


def _why_not(seat: Seat) -> Reason | None:
    if seat.candidacy != "standby":
        return None
    return Reason.of(Code.OTHER_LEADS, robot=seat.leader) if seat.leader else Reason(Code.NO_LEADER)


def _leading(leader: Leader) -> dict[str, Any]:
    plan = leader.plan
    placed_shape, gains = plan.shape_transition.placed_shape, plan.gains
    return {
        "at_bounds": plan.fenced is not None,
        "waits_for": plan.waits_for,
        "shape": plan.shape_transition.wish.shape,
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


def _latched(plan: Plan) -> dict[str, Any]:
    """The stop or the hold that a candidate keeps while another leads."""
    mode = plan.team_mode.rest.mode
    return {"latched": LeaderState(mode)} if mode else {}
