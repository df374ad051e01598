"""Compose a candidate's status from its parts."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from formation.leader.operator_requests import Seat
from formation.leader.plan import Plan
from formation.protocol.order import Refusal, mixed
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AnsweredRequest, LeaderState, LeaderStatus


class Report(NamedTuple):
    """The parts of a status."""

    name: str
    seat: Seat
    term: int
    """Its own term if it leads, else the newest known."""
    plan: Plan
    mission: str
    """The mission's fingerprint."""
    refusals: Mapping[str, Refusal]
    """Robots that refuse its term, and why."""
    mixed: Mapping[str, str]
    """Robots that run another mission, with its tag."""
    tag: str
    """Tag of its own mission."""
    beat: int
    late: int
    """Number of periods without a position."""
    dropped: Mapping[str, int]
    requests: tuple[AnsweredRequest, ...]
    """Recent operator requests."""
    forgers: Mapping[str, tuple[int, str]] = MappingProxyType({})
    """Robots that relayed forged orders lately: how many, and what was wrong with the newest."""


def status(report: Report, ends: str = "") -> LeaderStatus:
    """Return the status; `ends` says why the process ends, if it does."""
    seat, plan = report.seat, report.plan
    return LeaderStatus(
        robot=report.name,
        state=LeaderState(seat.mode if seat.leads else seat.candidacy),
        reason=Reason.of(Code.ENDED, cause=ends) if ends else _reason(report),
        leads=seat.leads,
        leader=seat.leader,
        term=report.term,
        mission=report.mission,
        requests=report.requests,
        refused_by=report.refusals,
        other_mission=report.mixed,
        forged={robot: why for robot, (_, why) in report.forgers.items()},
        forged_count={robot: count for robot, (count, _) in report.forgers.items()},
        dropped=report.dropped,
        **(_leading(report) if seat.leads else _latched(plan)),
    )


def _reason(report: Report) -> Reason | None:
    """Return what keeps robots from following, or else the leader from going on; None if nothing does."""
    if report.mixed:
        return mixed(*next(iter(report.mixed.items())), report.tag)
    if report.refusals:
        ahead = "ahead" in report.refusals.values()
        code = Code.TERM_AHEAD if ahead else Code.TERM_EARLIER
        return Reason.of(code, robots=tuple(report.refusals), term=report.term)
    return _why(report.plan) if report.seat.leads else _why_not(report.seat)


def _why(plan: Plan) -> Reason | None:
    if plan.team_mode.lost:
        return plan.team_mode.lost
    if (breach := plan.fenced) is not None:
        return Reason.of(
            Code.STOPPED_AT_BOUNDS, what=breach.what, axis=breach.axis, value=breach.value, limit=breach.limit
        )
    if waits_for := _waits_for(plan):
        return Reason.of(Code.WAITS, robots=waits_for)
    return Reason(Code.ROUTE_ENDED) if plan.route_time >= plan.route.total else None


def _why_not(seat: Seat) -> Reason | None:
    if seat.candidacy != "standby":
        return None
    return Reason.of(Code.OTHER_LEADS, robot=seat.leader) if seat.leader else Reason(Code.NO_LEADER)


def _waits_for(plan: Plan) -> tuple[str, ...]:
    stands = plan.team_mode.mode != "run" or plan.fenced is not None
    return () if stands else plan.cohesion.waits_for


def _leading(report: Report) -> dict[str, Any]:
    plan = report.plan
    placed_shape, gains = plan.shape_transition.placed_shape, plan.gains
    return {
        "at_bounds": plan.fenced is not None,
        "waits_for": _waits_for(plan),
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
        "beat": report.beat,
        "late": report.late,
    }


def _latched(plan: Plan) -> dict[str, Any]:
    """The stop or the hold that a candidate keeps while another leads."""
    mode = plan.team_mode.rest.mode
    return {"latched": LeaderState(mode)} if mode else {}
