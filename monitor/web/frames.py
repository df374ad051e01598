"""Messages to the page: the mission once, and then the formation at one moment after another. Pure.

A frame is rows of numbers without names, as it goes out ten times a second to every page; `FIELDS` names the
columns. Lengths [m], angles [rad], times [s, our system clock]. None always means unknown now.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from typing import Any

from formation.mission.model import Mission
from formation.monitor.metrics.events import Event
from formation.monitor.metrics.health import Health, health
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import AVOIDING, RobotMetrics, Snapshot
from formation.monitor.metrics.trajectory import Placed
from formation.topics import POSITION
from formation.wire import Now

FIELDS = (
    "x", "y", "heading", "point_x", "point_y", "slot_x", "slot_y", "error", "speed", "turn_rate",
    "speed_share", "turn_rate_share", "age", "rate", "loss", "health", "state", "reason",
    "true_x", "true_y", "heading_error", "health_why", "unavailable", "fallback",
    "avoiding",
)  # fmt: skip
"""Columns of a robot's row: its centre, its control point, the wanted control point, and metrics."""
MILLI, TENTH_MILLI = 3, 4
"""Decimals shown on a page; the finer one is only for a formation error."""


def hello(
    mission: Mission, *, live: bool, control: bool, version: str, law: str | None = None
) -> dict[str, Any]:
    """Return what does not change while the page is open. `control`: orders are accepted with the token.

    `law` is the one in use, if it is not the mission's.
    """
    index = {name: i for i, name in enumerate(mission.names)}
    return {
        "live": live,
        "mission": mission.name,
        "law": law or mission.law.kind,
        "settled": mission.settled,
        "control": control,
        "version": version,
        "robots": [_spec(mission, name) for name in mission.names],
        "edges": [
            [index[name], index[other]] for name in mission.names for other in mission.robots[name].neighbours
        ],
        "shapes": {
            shape: [_xy(mission.slot(name, shape)) for name in mission.names] for shape in mission.shapes
        },
        "posts": [[post.x, post.y, post.radius] for post in mission.simulation.posts],
        "walls": [[*wall.begin, *wall.end] for wall in mission.simulation.walls],
        "candidates": list(mission.candidates) if mission.standbys else [],
        "fields": list(FIELDS),
    }


def event(number: int, one: Event) -> dict[str, Any]:
    """Return one event; `number` is one more than that of the event before."""
    return {"n": number, **one._asdict(), "at": round(one.at, MILLI)}


def frame(
    mission: Mission,
    metrics: Metrics,
    now: Now,
    *,
    snapshot: Snapshot | None = None,
    recording: Mapping[str, Any] | None = None,
    replay: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the formation at `now`; `snapshot` is that of the same moment, if it exists.

    `recording` has path, bytes, seconds and failure; `replay` has t, start, end, speed and paused.
    """
    seen = snapshot or metrics.snapshot(now)
    moment, placed = metrics.placed(now)
    truly = metrics.placed(now, truly=True)[1]
    leader, slots = placed.get(mission.leader), metrics.slots(moment)
    rows = []
    for name in mission.names:
        slot = None if leader is None else leader.point + slots[name]
        well = health(name, seen.robots[name], mission.robots[name], contested=name in seen.contested)
        rows.append(_row(mission, name, seen.robots[name], placed.get(name), truly.get(name), slot, well))
    return {
        "t": round(now.wall, MILLI),
        "elapsed": _round(seen.elapsed),
        "error": _round(seen.formation_error, TENTH_MILLI),
        **_known(seen),
        "true": _round(seen.formation_error_true, TENTH_MILLI),
        "settled_at": _round(seen.settled_at),
        "converged": seen.converged,
        "mode": seen.mode,
        "shape": seen.shape,
        "missed": seen.missed,
        "rejected": sum(seen.rejected.values()),
        "recording": recording,
        "r": rows,
        "e": [_round(error, TENTH_MILLI) for error in seen.edges.values()],
        **_wished(seen),
        **_leading(seen),
        **({} if replay is None else {"replay": replay}),
    }


def _known(seen: Snapshot) -> dict[str, Any]:
    """Return, if edges are unknown, the error over the known ones, their number, the total, and the cause."""
    known, verdict = seen.known, seen.known_verdict
    if known.complete or known.error is None:
        return {}
    over = [known.known_edges, known.edges, known.words]
    return {"known": [_round(known.error, TENTH_MILLI), *over, _round(verdict.settled_at), verdict.converged]}


def _wished(seen: Snapshot) -> dict[str, Any]:
    """Return the wish except its shape; values as drawn are left out."""
    if seen.wish is None:
        return {}
    return {
        **({"rotation": _round(seen.wish.rotation)} if seen.wish.rotation else {}),
        **({"scale": _round(seen.wish.scale)} if seen.wish.scale != 1.0 else {}),
        **({} if seen.formed else {"forming": True}),
        **({"waits": seen.waits} if seen.waits else {}),
    }


def _leading(seen: Snapshot) -> dict[str, Any]:
    """Return the leader, since when, and a row for each candidate, in the order of the mission."""
    if not seen.candidates:
        return {}
    return {
        "leads": seen.leads,
        "since": _round(seen.lead.since if seen.lead else None),
        "c": [[one.state, one.reason, _round(one.age)] for one in seen.candidates.values()],
    }


def _spec(mission: Mission, name: str) -> dict[str, Any]:
    robot = mission.robots[name]
    return {
        "name": name,
        "leader": name == mission.leader,
        "max_speed": robot.max_speed,
        "max_turn_rate": robot.max_turn_rate,
        "offset": _offset(mission, name),
        "rate": robot.rate,
    }


def _row(
    mission: Mission,
    name: str,
    robot: RobotMetrics,
    place: Placed | None,
    truth: Placed | None,
    slot: complex | None,
    well: Health,
) -> list[Any]:
    offset = _offset(mission, name)
    return [
        *_xy(_centre(place, offset)),
        None if place is None else _round(cmath.phase(place.heading)),
        *_xy(None if place is None else place.point),
        *_xy(slot),
        _round(robot.error, TENTH_MILLI),
        _round(robot.speed),
        _round(robot.turn_rate),
        _round(robot.speed_share),
        _round(robot.turn_share),
        _round(robot.age),
        _round(robot.rate, 1),
        _round(robot.keys[POSITION.key(name)].loss),
        _round(well.share, 2),
        robot.shown,
        robot.reason,
        *_xy(_centre(truth, offset)),
        _round(robot.heading_error),
        well.why,
        2 if robot.stuck else int(robot.unavailable),
        robot.fallback,
        AVOIDING.get(robot.avoiding, ""),
    ]


def _offset(mission: Mission, name: str) -> float:
    """Return the distance from the centre to the control point [m]; 0 for the leader."""
    return 0.0 if name == mission.leader else mission.robots[name].control_point_offset


def _centre(place: Placed | None, offset: float) -> complex | None:
    return None if place is None else place.point - offset * place.heading


def _xy(point: complex | None) -> list[float | None]:
    return [None, None] if point is None else [_round(point.real), _round(point.imag)]


def _round(value: float | None, digits: int = MILLI) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, digits)
