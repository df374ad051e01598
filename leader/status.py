"""How a candidate says how it does."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from formation.figure import Figure
from formation.order import FORGED_ORDER, Refusal, mixed
from formation.ros2.messages import Diagnostics, Status
from formation.wire import Now
from leader.conduct import Conduct
from leader.desk import Asked, Seat

OK, WARNING = 0, 1
LONGEST_ASKED = 45_000
"""Of what was asked so much stands in a status: the longest route, and what else there is room for."""


class Report(NamedTuple):
    """What a status is made of."""

    name: str
    seat: Seat
    term: int
    """Its own if it leads, else the highest that it has heard of."""
    conduct: Conduct
    mission: str
    """Its fingerprint."""
    refusals: Mapping[str, Refusal]
    """Robots that refuse its term, and why."""
    mixed: Mapping[str, str]
    """Robots that run another mission, with its tag."""
    tag: str
    """Of its own mission."""
    beat: int
    late: int
    """Periods that passed without a position."""
    dropped: Mapping[str, int]
    asked: Sequence[Asked]
    """What an operator has asked for of late."""
    forgers: Mapping[str, str] = MappingProxyType({})
    """Robots that relayed forged orders of late: how many, and what was wrong with the newest."""


def status(report: Report, now: Now, reason: str) -> Diagnostics:
    """The message; `reason` if there is a special one."""
    seat = report.seat
    leads, state = seat.leads, seat.mode if seat.leads else seat.standing
    why = reason or _doubts(report) or (_why(report.conduct) if leads else _why_not(report))
    values = {
        "state": state,
        "reason": why,
        "leads": "yes" if leads else "no",
        "leader": seat.leader,
        "term": str(report.term),
        "mission": report.mission,
        **({"asked": _spelled(report.asked)} if report.asked else {}),
        **(_conducted(report) if leads else _latched(report.conduct)),
        **{f"refused by {robot}": because for robot, because in report.refusals.items()},
        **{f"other mission {robot}": tag or "unknown" for robot, tag in report.mixed.items()},
        **{f"{FORGED_ORDER}{robot}": why for robot, why in report.forgers.items()},
        **{f"dropped {key}": str(count) for key, count in report.dropped.items()},
    }
    doubts = report.forgers or report.mixed or report.refusals or (leads and report.conduct.fenced)
    level = OK if state in {"run", "standby"} and not doubts else WARNING
    message = f"{state}: {why}" if why else state
    if report.forgers:
        message += f"; {', '.join(report.forgers)} relayed forged orders"
    what = Status(f"{report.name}: leader", level, message, report.name, values)
    return Diagnostics(now.wall, (what,))


def spelled(figure: Figure) -> str:
    """``hexagon``, or ``40 % hexagon + 60 % line, turned by 30°, scale 1.2``."""
    shares = [(shape, share) for shape, share in figure.mix if share > 0.0]
    whole = len(shares) == 1
    said = [" + ".join(shape if whole else f"{100.0 * share:.0f} % {shape}" for shape, share in shares)]
    if abs(figure.rotation) > 1e-6:
        said.append(f"turned by {math.degrees(figure.rotation):.1f}°")
    if abs(figure.scale - 1.0) > 1e-6:
        said.append(f"scale {figure.scale:.3g}")
    return ", ".join(said)


def _spelled(asked: Sequence[Asked]) -> str:
    """A JSON list: each request as it was put, with whether it was obeyed (``ok``) and the ``reason``.

    Of many long ones the newest that a status has room for.
    """
    said: list[str] = []
    for one in reversed(asked):
        spelled = json.dumps({**one.request.spelled, "ok": one.ok, "reason": one.reason}, ensure_ascii=False)
        if len(spelled) + sum(map(len, said)) <= LONGEST_ASKED:
            said.insert(0, spelled)
    return f"[{', '.join(said)}]"


def _doubts(report: Report) -> str:
    """What keeps robots from following, in words; empty for nothing."""
    if report.mixed:
        return mixed(*next(iter(report.mixed.items())), report.tag)
    if report.refusals:
        robots = ", ".join(report.refusals)
        ahead = "ahead" in report.refusals.values()
        why = "is over a day ahead: set the clocks (chronyc tracking)" if ahead else "is an earlier one"
        return f"{robots} refuse{'' if ', ' in robots else 's'} term {report.term}, which {why}"
    return ""


def _why(conduct: Conduct) -> str:
    if conduct.will.lost:
        return conduct.will.lost
    if conduct.fenced:
        return f"stopped at the bounds: {conduct.fenced} next; order a speed or route that leads back"
    if conduct.will.mode == "run" and conduct.together.waits_for:
        return f"waits for {', '.join(conduct.together.waits_for)}"
    return "at the end of the route" if conduct.route_time >= conduct.course.total else ""


def _why_not(report: Report) -> str:
    if report.seat.standing == "standby":
        return f"{report.seat.leader} leads" if report.seat.leader else "nobody leads"
    return ""


def _conducted(report: Report) -> dict[str, str]:
    conduct = report.conduct
    return {
        "shape": conduct.mover.wish.shape,
        "figure": spelled(conduct.mover.figure),
        "changing": f"{conduct.mover.remaining:.1f}",
        "gains": conduct.gains.words,
        "route": conduct.course.id,
        "route_time": f"{conduct.route_time:.3f}",
        "pace": f"{conduct.pace:.2f}",
        "beat": str(report.beat),
        "late": str(report.late),
    }


def _latched(conduct: Conduct) -> dict[str, str]:
    """The stop or the hold that a candidate keeps while another leads."""
    mode = conduct.will.rest.mode
    return {"latched": mode} if mode else {}
