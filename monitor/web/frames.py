"""Messages to the page: the mission once, and then the formation at one moment after another. Pure.

A frame is rows of numbers without names, as it goes out ten times a second to every page; `FIELDS` names the
columns. Lengths [m], angles [rad], times [s, our system clock]. None always means unknown now.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from formation.mission.model import Mission
from formation.mission.robot import RobotSpec
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.events import LOST_SILENCE
from formation.monitor.metrics.feed import clock_agrees, freshness_limit, rounded
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import AVOIDING, SIGHT, RobotMetrics, Snapshot
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
ERROR_DECIMALS = 4
"""Decimals of a formation error in metres; other numbers have three."""
MIN_RATE_SHARE = 0.9
"""Share of the promised rate that counts as full."""
LOSS_BEARABLE, LOSS_WEIGHT = 0.01, 3.0
"""Share of missed periods that is tolerated; health lost per share beyond it."""
CLOCK_OFF, REJECTED, SECOND_PUBLISHER, UNAVAILABLE = 0.6, 0.6, 0.3, 0.6
"""Health left to a robot with a wrong clock, with rejected messages, with a second publisher, and to one that
is unavailable."""
REJECTION_TIME = 10.0
"""How long a rejected message counts [s]."""
HEALTH_OF_STATE = {"run": 1.0, "waiting": 0.7, "hold": 0.6, "stop": 0.5}
STATUSLESS_HEALTH = 0.5
"""Health of a robot that moves along but publishes no status."""


def hello(mission: Mission, *, live: bool, control: bool, version: str) -> dict[str, Any]:
    """Return what does not change while the page is open. `control`: orders are accepted with the token."""
    index = {name: i for i, name in enumerate(mission.names)}
    return {
        "live": live,
        "mission": mission.name,
        "law": mission.law.kind,
        "settled": mission.settled,
        "control": control,
        "version": version,
        "robots": [
            {
                "name": name,
                "leader": name == mission.leader,
                "max_speed": robot.max_speed,
                "max_turn_rate": robot.max_turn_rate,
                "offset": _offset(mission, name),
                "rate": robot.rate,
            }
            for name, robot in ((name, mission.robots[name]) for name in mission.names)
        ],
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
    return {"n": number, **one._asdict(), "at": rounded(one.at)}


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
    snapshot = snapshot or metrics.snapshot(now)
    moment, placed = metrics.placed(now)
    truly = metrics.placed(now, truly=True)[1]
    leader, slots = placed.get(mission.leader), metrics.orders.slots(moment)
    rows = []
    for name in mission.names:
        slot = None if leader is None else leader.point + slots[name]
        robot, contested = snapshot.robots[name], name in snapshot.contested
        places = placed.get(name), truly.get(name)
        fitness = health(name, robot, mission.robots[name], contested=contested)
        rows.append(_row(name, robot, _offset(mission, name), places, slot, fitness))
    return {
        "t": rounded(now.wall),
        "elapsed": rounded(snapshot.elapsed),
        "error": rounded(snapshot.formation_error, ERROR_DECIMALS),
        **_known(snapshot),
        "true": rounded(snapshot.formation_error_true, ERROR_DECIMALS),
        "settled_at": rounded(snapshot.settled_at),
        "converged": snapshot.converged,
        "mode": snapshot.mode,
        "shape": snapshot.shape,
        "missed": snapshot.missed,
        "rejected": sum(snapshot.rejected.values()),
        "recording": recording,
        "r": rows,
        "e": [rounded(error, ERROR_DECIMALS) for error in snapshot.edges.values()],
        **_ordered(snapshot),
        **_leading(snapshot),
        **({} if replay is None else {"replay": replay}),
    }


def _known(snapshot: Snapshot) -> dict[str, Any]:
    """Return, if edges are unknown, the error over the known ones, their number, the total, and the cause."""
    known, verdict = snapshot.known, snapshot.known_verdict
    if known.complete or known.error is None:
        return {}
    over = [known.known_edges, known.edges, known.words]
    return {
        "known": [rounded(known.error, ERROR_DECIMALS), *over, rounded(verdict.settled_at), verdict.converged]
    }


def _ordered(snapshot: Snapshot) -> dict[str, Any]:
    if snapshot.ordered is None:
        return {}
    return {
        **({"rotation": rounded(snapshot.ordered.rotation)} if snapshot.ordered.rotation else {}),
        **({"scale": rounded(snapshot.ordered.scale)} if snapshot.ordered.scale != 1.0 else {}),
        **({} if snapshot.formed else {"forming": True}),
        **({"waits": snapshot.waits} if snapshot.waits else {}),
    }


def _leading(snapshot: Snapshot) -> dict[str, Any]:
    if not snapshot.candidates:
        return {}
    return {
        "leads": snapshot.leads,
        "since": rounded(snapshot.lead.since if snapshot.lead else None),
        "c": [[one.state, one.reason, rounded(one.age)] for one in snapshot.candidates.values()],
    }


def _row(
    name: str, robot: RobotMetrics, offset: float, places: tuple[Placed | None, Placed | None],
    slot: complex | None, fitness: Health,
) -> list[Any]:  # fmt: skip
    """Return the values of `FIELDS`; `places` by its own positions and in truth."""
    place, truth = places
    return [
        *_xy(_centre(place, offset)),
        None if place is None else rounded(cmath.phase(place.heading)),
        *_xy(None if place is None else place.point),
        *_xy(slot),
        rounded(robot.error, ERROR_DECIMALS),
        rounded(robot.speed),
        rounded(robot.turn_rate),
        rounded(robot.speed_share),
        rounded(robot.turn_share),
        rounded(robot.age),
        rounded(robot.rate, 1),
        rounded(robot.keys[POSITION.key(name)].loss),
        rounded(fitness.share, 2),
        robot.shown,
        robot.reason,
        *_xy(_centre(truth, offset)),
        rounded(robot.heading_error),
        fitness.why,
        2 if robot.stuck else int(robot.unavailable),
        robot.fallback,
        AVOIDING.get(robot.avoiding) or SIGHT.get(robot.sight, ""),
    ]


def _offset(mission: Mission, name: str) -> float:
    """Return the distance from the centre to the control point [m]; 0 for the leader."""
    return 0.0 if name == mission.leader else mission.robots[name].control_point_offset


def _centre(place: Placed | None, offset: float) -> complex | None:
    return None if place is None else place.point - offset * place.heading


def _xy(point: complex | None) -> list[float | None]:
    return [None, None] if point is None else [rounded(point.real), rounded(point.imag)]


class Health(NamedTuple):
    """The health of one robot."""

    share: float
    """From 0 (lost) to 1 (no fault)."""
    why: str
    """The worst fault; empty if there is none."""


def health(name: str, metrics: RobotMetrics, spec: RobotSpec, *, contested: bool = False) -> Health:
    """Return the health of robot `name`; `contested` if a second publisher sends its positions.

    Every fault leaves a share of it; the shares multiply, so two half faults are worse than one. It is for
    display: it shows where to look first, and its words say why. Nothing is decided by it.
    """
    share, worst, why = 1.0, 1.0, ""
    for part, reason in _parts(name, metrics, spec, contested=contested):
        share *= part
        if part < worst:
            worst, why = part, reason
    return Health(share, why)


def _parts(
    name: str, metrics: RobotMetrics, spec: RobotSpec, *, contested: bool
) -> Iterator[tuple[float, str]]:
    if metrics.age is None:
        yield 0.0, "nothing received yet"
        return
    fresh = freshness_limit(spec.rate)
    lost = max(LOST_SILENCE, 2.0 * fresh)
    yield min(max((lost - metrics.age) / (lost - fresh), 0.0), 1.0), f"silent for {metrics.age:.1f} s"
    if metrics.rate is not None:
        rate_share = metrics.rate / (MIN_RATE_SHARE * spec.rate)
        yield min(rate_share, 1.0), f"{metrics.rate:.1f} Hz of {spec.rate:g} Hz"
    position = metrics.keys[POSITION.key(name)]
    if position.loss is not None:
        left = 1.0 - LOSS_WEIGHT * max(0.0, position.loss - LOSS_BEARABLE)
        yield max(left, 0.1), f"{position.loss:.0%} of its positions missed"
    if position.clock is not None and not clock_agrees(position.clock):
        yield CLOCK_OFF, f"its clock is {position.clock:.1f} s off"
    if metrics.rejected_age is not None and metrics.rejected_age < REJECTION_TIME:
        yield REJECTED, "messages rejected"
    if contested:
        yield SECOND_PUBLISHER, "it has a second publisher"
    if metrics.unavailable:
        yield UNAVAILABLE, "unavailable: others go on without it"
    yield HEALTH_OF_STATE.get(metrics.state, STATUSLESS_HEALTH), f"{metrics.state}: {metrics.reason}"
