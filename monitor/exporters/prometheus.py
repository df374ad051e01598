"""The metrics in Prometheus format: units in the names, robots and keys in the labels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, get_args

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from formation.monitor.metrics.snapshot import KeyMetrics, RobotMetrics, Snapshot
from formation.protocol.order import Mode

ROBOT: tuple[tuple[str, str, Callable[[RobotMetrics], float | None]], ...] = (
    ("error_meters", "Sum over the robot's edges of the formation error", lambda one: one.error),
    ("speed_meters_per_second", "Commanded forward speed", lambda one: one.speed),
    ("turn_rate_radians_per_second", "Commanded turn rate", lambda one: one.turn_rate),
    ("speed_limit_ratio", "Commanded forward speed as a share of its limit", lambda one: one.speed_share),
    ("turn_rate_limit_ratio", "Commanded turn rate as a share of its limit", lambda one: one.turn_share),
    ("heading_error_radians", "Estimated less true heading", lambda one: one.heading_error),
    ("position_age_seconds", "Since its last position arrived", lambda one: one.age),
    ("unavailable", "1 while it is unavailable, and others go on without it", lambda one: one.unavailable),
    ("stuck", "1 while it does not move as commanded", lambda one: one.stuck),
    ("avoiding", "1 while it avoids a collision, or its protective zone slows or stops it",
     lambda one: bool(one.avoiding)),
    ("deadlocks", "Deadlocks that it resolved since its agent's start",
     lambda one: one.deadlocks),
    ("publishers", "Processes that have published its positions; each start is another",
     lambda one: one.publishers),
)  # fmt: skip
"""Gauges of one robot: name after ``formation_robot_``, help, and the field with the value."""
KEY: tuple[tuple[str, str, Callable[[KeyMetrics], float | None]], ...] = (
    ("rate_hertz", "Messages per second of the newest few", lambda one: one.rate),
    ("age_seconds", "Since the last message arrived", lambda one: one.age),
    ("clock_offset_seconds", "Median of arrival less stamp: clocks, and the network's delay",
     lambda one: one.clock),
)  # fmt: skip
"""Gauges of one key."""


def exposition(snapshot: Snapshot, recording: Mapping[str, Any] | None, accept: str) -> tuple[bytes, str]:
    """Return the metrics in the format that `accept` requests, and its content type.

    `recording` is a frame's: path, bytes, seconds and failure, or None if nothing is recorded.
    """
    registry = CollectorRegistry()
    registry.register(MetricsCollector(snapshot, recording))
    encode, content_type = choose_encoder(accept)
    return encode(registry), content_type


class MetricsCollector(Collector):
    """One snapshot. Unknown values are left out."""

    def __init__(self, snapshot: Snapshot, recording: Mapping[str, Any] | None) -> None:
        self._snapshot, self._recording = snapshot, recording

    def collect(self) -> Iterator[Metric]:
        """Yield every metric."""
        yield from _formation(self._snapshot)
        yield from _shape(self._snapshot)
        yield from _leading(self._snapshot)
        yield _rejected(self._snapshot)
        yield from _robots(self._snapshot)
        yield from _keys(self._snapshot)
        if self._recording is not None:
            bytes_, seconds = self._recording.get("bytes"), self._recording.get("seconds")
            failed = float(self._recording.get("failure") is not None)
            yield _gauge("recording_bytes", "Size of the recording", bytes_)
            yield _gauge("recording_seconds", "Length of the recording", seconds)
            yield _gauge("recording_failed", "1 if the recording has failed", failed)


def _formation(snapshot: Snapshot) -> Iterator[Metric]:
    known, verdict = snapshot.known, snapshot.verdict_now
    yield _gauge("error_meters", "Sum over all edges", snapshot.formation_error)
    yield _gauge("known_error_meters", "Sum over the edges that are known", known.error)
    yield _gauge("known_edges", "Edges that are known", known.known_edges)
    yield _gauge("edges", "All edges", known.edges)
    yield _gauge("known_converged", "1 while known edges have stayed under the bound", verdict.converged)
    yield _gauge("error_true_meters", "The same from ground truth", snapshot.formation_error_true)
    yield _gauge("elapsed_seconds", "Since the error was first known", snapshot.elapsed)
    yield _gauge("settled_seconds", "When the error fell under the bound for good", snapshot.settled_at)
    yield _gauge("converged", "1 while it is known and has stayed there for 2 s", snapshot.converged_now)
    modes = {(mode,): mode == snapshot.mode for mode in get_args(Mode)}
    yield _gauges("mode", "1 for the mode that the leader orders", ["mode"], modes)


def _shape(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the wanted shape and the current one."""
    ordered, now = snapshot.ordered, snapshot.placed_shape
    rotation = "counter-clockwise; of a shape that turns with the leader, from its heading"
    mix = {(shape,): part for shape, part in now.mix}
    yield _gauges("shape", "1 for the shape in force", ["shape"], {(snapshot.shape,): 1.0})
    yield _gauge("rotation_radians", f"Ordered rotation, {rotation}", ordered.rotation if ordered else None)
    yield _gauge("scale_ratio", "Ordered scale", ordered.scale if ordered else None)
    yield _gauge("shape_rotation_radians", "Rotation by now, from the world's x", now.rotation)
    yield _gauge("shape_scale_ratio", "Scale by now", now.scale)
    yield _gauges("shape_share_ratio", "Share of a shape in the present mix", ["shape"], mix)
    yield _gauge("shape_formed", "1 once the shape is where it is wanted", snapshot.formed)


def _leading(snapshot: Snapshot) -> Iterator[Metric]:
    leader = {} if snapshot.leads is None else {(snapshot.leads,): 1.0}
    term = snapshot.lead.term * 1e-9 if snapshot.lead else None
    states = {(name, one.state): 1.0 for name, one in snapshot.candidates.items()}
    yield _gauges("leader_info", "1 for the process that leads", ["leader"], leader)
    yield _gauge("leader_term_seconds", "When the term began, by the leader's clock", term)
    yield _gauge("leader_waits", "1 while the leader waits for robots", bool(snapshot.waits))
    yield _gauges("candidate_state", "1 for the candidate's state", ["candidate", "state"], states)


def _rejected(snapshot: Snapshot) -> Metric:
    what = "Rejected messages"
    rejected = CounterMetricFamily("formation_messages_rejected", what, labels=["key", "reason"])
    for text, count in snapshot.rejected.items():
        key, _, reason = text.partition(": ")
        rejected.add_metric([key, reason], count)
    return rejected


def _robots(snapshot: Snapshot) -> Iterator[Metric]:
    edges = {(robot, f"{robot}-{other}"): error for (robot, other), error in snapshot.edges.items()}
    yield _gauges("edge_error_meters", "Measured less desired displacement", ["robot", "edge"], edges)
    for name, what, value_of in ROBOT:
        values = {(robot,): value_of(metrics) for robot, metrics in snapshot.robots.items()}
        yield _gauges(f"robot_{name}", what, ["robot"], values)
    states = {(robot, metrics.shown): 1.0 for robot, metrics in snapshot.robots.items()}
    yield _gauges("robot_state", "1 for the state in its status", ["robot", "state"], states)


def _keys(snapshot: Snapshot) -> Iterator[Metric]:
    labels = ["robot", "key"]
    keys = {
        (robot, key): metrics
        for robot, one in snapshot.robots.items()
        for key, metrics in one.keys.items()
        if metrics.count
    }
    received = CounterMetricFamily("formation_messages_received", "Received", labels=labels)
    what = "Periods without a message: lost, or skipped"
    missed = CounterMetricFamily("formation_messages_missed", what, labels=labels)
    for which, metrics in keys.items():
        received.add_metric(which, metrics.count)
        missed.add_metric(which, metrics.missed)
    yield from (received, missed)
    for name, what, value_of in KEY:
        values = {which: value_of(metrics) for which, metrics in keys.items()}
        yield _gauges(f"key_{name}", what, labels, values)


def _gauge(name: str, what: str, value: float | None) -> Metric:
    return _gauges(name, what, [], {(): value})


def _gauges(name: str, what: str, labels: Sequence[str], values: Mapping[Any, float | None]) -> Metric:
    """Return a gauge with its `values`, by tuples of what its `labels` say."""
    family = GaugeMetricFamily(f"formation_{name}", what, labels=labels)
    for which, value in values.items():
        if value is not None:
            family.add_metric(which, float(value))
    return family
