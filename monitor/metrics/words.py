"""A snapshot put into words: JSON for programs, a line for people, diagnostics for ROS tools."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from formation.monitor.metrics.events import LOST_SILENCE
from formation.monitor.metrics.feed import rounded
from formation.monitor.metrics.snapshot import KeyMetrics, RobotMetrics, Snapshot
from formation.monitor.metrics.statuses import SILENT
from formation.ros2.messages import Diagnostics, Status
from formation.slots.shape import PlacedShape

OK, WARNING, STALE = 0, 1, 3
CORRECTION_SHOWN = 0.01
"""Least correction of odometry by scans that is mentioned [m]."""
ROBOTS_PER_MESSAGE = 25
"""Most robots in one diagnostics message, well under the longest message that is read."""


def as_json(snapshot: Snapshot) -> dict[str, Any]:
    """Return data for a live table: lengths [m], speeds [m/s], angles [rad], times [s]. None: unknown now."""
    return {
        "elapsed": rounded(snapshot.elapsed),
        "formation_error": rounded(snapshot.formation_error, 6),
        "formation_error_true": rounded(snapshot.formation_error_true, 6),
        "known": snapshot.verdict_now._replace(final=snapshot.known).as_json(),
        "settled_at": rounded(snapshot.settled_at),
        "converged": snapshot.converged_now,
        "mode": snapshot.mode,
        "shape": snapshot.shape,
        "rotation": rounded(snapshot.ordered.rotation if snapshot.ordered else None, 6),
        "scale": rounded(snapshot.ordered.scale if snapshot.ordered else None, 6),
        "route": snapshot.ordered.route if snapshot.ordered else None,
        "placed_shape": _placed_shape(snapshot.placed_shape),
        "formed": snapshot.formed,
        "gains": snapshot.tuned.model_dump() if snapshot.tuned else None,
        "ordered_at": rounded(snapshot.ordered_at),
        "settling_time": rounded(snapshot.settling_time),
        "leads": snapshot.leads,
        "term": snapshot.lead.term if snapshot.lead else None,
        "waits": snapshot.waits,
        "candidates": {name: one._asdict() for name, one in snapshot.candidates.items()},
        "robots": {name: _robot(robot) for name, robot in snapshot.robots.items()},
        "edges": [[*edge, rounded(error, 6)] for edge, error in snapshot.edges.items()],
        "missed": snapshot.missed,
        "rejected": dict(snapshot.rejected),
    }


def line(snapshot: Snapshot) -> str:
    """Return the formation in one line."""
    error = error_words(snapshot)
    if snapshot.formation_error_true is not None:
        error += f" (true {_length(snapshot.formation_error_true)})"
    corrections = {name: one.correction or 0.0 for name, one in snapshot.robots.items()}
    worst = max(corrections, key=corrections.__getitem__)
    if corrections[worst] > CORRECTION_SHOWN:
        error += f" (odometry alone would be off by up to {_length(corrections[worst])}: {worst})"
    settled = snapshot.settled_at if snapshot.known.complete else snapshot.known_verdict.settled_at
    settled = None if snapshot.known.error is None else settled
    parts = [
        f"{snapshot.elapsed:6.1f} s",
        f"error {error}",
        "" if settled is None else f"settled at {settled:.1f} s",
        state_counts(robot.shown for robot in snapshot.robots.values()),
        _leader_in_words(snapshot),
        f"waits for {snapshot.waits}" if snapshot.waits else "",
        *(
            f"{name} silent for {robot.age:.1f} s"
            for name, robot in snapshot.robots.items()
            if robot.age is not None and robot.age > LOST_SILENCE and snapshot.known.error is None
        ),
        f"{snapshot.missed} missed" if snapshot.missed else "",
        f"{sum(snapshot.rejected.values())} rejected" if snapshot.rejected else "",
    ]
    return "  ".join(part for part in parts if part)


def state_counts(states: Iterable[str]) -> str:
    """Return the number of robots in each state that is known: ``5 run, 1 hold``."""
    return ", ".join(f"{count} {state}" for state, count in Counter(filter(None, states)).items())


def error_words(snapshot: Snapshot) -> str:
    """Return the formation error in words; if edges are unknown, with their number and cause."""
    known = snapshot.known
    if known.error is None:
        return "unknown"
    return _length(known.error) + ("" if known.complete else f" over {known.words}")


def _leader_in_words(snapshot: Snapshot) -> str:
    """Return the leader in words if it may change, and the candidates that could not lead."""
    if not snapshot.candidates:
        return ""
    silent = [name for name, one in snapshot.candidates.items() if one.state == SILENT]
    parts = [f"{snapshot.leads} leads" if snapshot.leads else "no leader"]
    return ", ".join(parts + [f"{name} could not" for name in silent])


def diagnostics(snapshot: Snapshot, stamp: float) -> Iterator[Diagnostics]:
    """Yield the snapshot of `stamp` [s, our system clock] as one or more messages."""
    statuses = [_formation_status(snapshot)]
    for name, robot in snapshot.robots.items():
        errors = {edge.neighbour: error for edge, error in snapshot.edges.items() if edge.robot == name}
        statuses.append(_robot_status(name, robot, errors))
    for first in range(0, len(statuses), ROBOTS_PER_MESSAGE):
        yield Diagnostics(stamp, tuple(statuses[first : first + ROBOTS_PER_MESSAGE]))


def _formation_status(snapshot: Snapshot) -> Status:
    known, verdict = snapshot.known, snapshot.verdict_now
    values = {
        "error": _text(snapshot.formation_error),
        "known_error": _text(known.error),
        "known_edges": str(known.known_edges),
        "edges": str(known.edges),
        "known_settled_at": _text(verdict.settled_at),
        "known_converged": str(verdict.converged).lower(),
        "error_true": _text(snapshot.formation_error_true),
        "elapsed": _text(snapshot.elapsed),
        "settled_at": _text(snapshot.settled_at),
        "converged": str(snapshot.converged_now).lower(),
        "mode": snapshot.mode or "",
        "shape": snapshot.shape,
        **_wanted(snapshot),
        **_leading(snapshot),
        "missed": str(snapshot.missed),
        **{f"rejected.{reason}": str(count) for reason, count in snapshot.rejected.items()},
    }
    message = "error unknown" if known.error is None else f"error {known.error:.4f} m"
    if known.error is not None and not known.complete:
        message += f" over {known.words}"
    level = WARNING if snapshot.rejected or not known.complete else OK
    level = STALE if known.error is None else level
    return Status("formation: monitor", level, message, "", values)


def _wanted(snapshot: Snapshot) -> dict[str, str]:
    """Return what is ordered and its progress; angles counter-clockwise."""
    if snapshot.ordered is None:
        return {}
    return {
        "rotation": _text(snapshot.ordered.rotation),
        "scale": _text(snapshot.ordered.scale),
        "route": snapshot.ordered.route,
        **({"k_p": _text(snapshot.tuned.k_p), "k_i": _text(snapshot.tuned.k_i)} if snapshot.tuned else {}),
        "rotation_now": _text(snapshot.placed_shape.rotation),
        "scale_now": _text(snapshot.placed_shape.scale),
        **{f"share.{shape}": _text(share) for shape, share in snapshot.placed_shape.mix},
    }


def _leading(snapshot: Snapshot) -> dict[str, str]:
    lead = {"leader": snapshot.leads or "", "term": str(snapshot.lead.term)} if snapshot.lead else {}
    waits = {"waits_for": snapshot.waits} if snapshot.waits else {}
    candidates = {f"candidate.{name}": one.state for name, one in snapshot.candidates.items()}
    return lead | waits | candidates


def _robot_status(name: str, robot: RobotMetrics, errors: Mapping[str, float | None]) -> Status:
    values = {f"error.{neighbour}": _text(error) for neighbour, error in errors.items()}
    values |= {field: _text(getattr(robot, field)) for field in ("heading_error", "speed", "turn_rate")}
    for field in ("unavailable", "stuck", "avoiding", "deadlocks", "fallback", "sight", "correction"):
        if value := getattr(robot, field):
            values[field] = "true" if value is True else str(value)
    for key, metrics in robot.keys.items():
        values |= {f"{what}.{key.partition('/')[2]}": text for what, text in _key(metrics)}
    fresh = robot.age is not None and robot.age <= LOST_SILENCE
    level = (OK if robot.shown == "run" else WARNING) if fresh else STALE
    return Status(f"{name}: monitor", level, f"{robot.shown}: {robot.reason}", name, values)


def _key(metrics: KeyMetrics) -> Iterator[tuple[str, str]]:
    """Yield rate, age and losses of a key, if it was ever received."""
    if metrics.count:
        yield "count", str(metrics.count)
        yield "rate", _text(metrics.rate, 1)
        yield "age", _text(metrics.age, 3)
        yield "missed", str(metrics.missed)
        if metrics.clock is not None:
            yield "clock", _text(metrics.clock)


def _robot(robot: RobotMetrics) -> dict[str, Any]:
    return {
        "state": robot.shown,
        "reason": robot.reason,
        "reason_code": robot.reason_code,
        "error": rounded(robot.error, 6),
        "known": [rounded(robot.known.error, 6), robot.known.known_edges, robot.known.edges],
        "speed": rounded(robot.speed, 4),
        "turn_rate": rounded(robot.turn_rate, 4),
        "speed_share": rounded(robot.speed_share, 4),
        "turn_share": rounded(robot.turn_share, 4),
        "age": rounded(robot.age),
        "heading_error": rounded(robot.heading_error, 5),
        "rate": rounded(robot.rate, 2),
        "unavailable": robot.unavailable,
        "stuck": robot.stuck,
        "avoiding": robot.avoiding,
        "deadlocks": robot.deadlocks,
        "fallback": robot.fallback,
        "sight": robot.sight,
        "seen": {name: rounded(deviation, 4) for name, deviation in robot.seen.items()},
        "correction": rounded(robot.correction, 4),
        "publishers": robot.publishers,
    }


def _placed_shape(placed_shape: PlacedShape) -> dict[str, Any]:
    mix = {shape: rounded(share, 4) for shape, share in placed_shape.mix}
    return {
        "mix": mix,
        "rotation": rounded(placed_shape.rotation, 6),
        "scale": rounded(placed_shape.scale, 6),
    }


def _length(metres: float) -> str:
    return f"{metres * 1e3:.1f} mm" if abs(metres) < 1.0 else f"{metres:.2f} m"


def _text(value: float | None, digits: int = 4) -> str:
    return "unknown" if value is None else f"{value:.{digits}f}"
