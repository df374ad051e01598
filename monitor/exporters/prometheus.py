"""The metrics in Prometheus format: units in the names, robots and keys in the labels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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
    (
        "unavailable",
        "1 while it is unavailable, and others go on without it",
        lambda one: float(one.unavailable),
    ),
    ("stuck", "1 while it does not move though it is told to", lambda one: float(one.stuck)),
    (
        "avoiding",
        "1 while it avoids a collision, or its protective zone slows or stops it",
        lambda one: float(bool(one.avoiding)),
    ),
    (
        "deadlocks",
        "How often it was kept from moving, and went another way, since its agent's start",
        lambda one: float(one.deadlocks),
    ),
    (
        "publishers",
        "Processes that have spoken for it: each start is another",
        lambda one: float(one.publishers),
    ),
)
"""Gauges of one robot: name after ``formation_robot_``, help, and the field with the value."""
KEY: tuple[tuple[str, str, Callable[[KeyMetrics], float | None]], ...] = (
    ("rate_hertz", "Messages per second of the newest few", lambda one: one.rate),
    ("age_seconds", "Since the last message arrived", lambda one: one.age),
    (
        "clock_offset_seconds",
        "Median of arrival less stamp: clocks, and the network's delay",
        lambda one: one.clock,
    ),
)
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
        yield from self._formation()
        yield from self._edges()
        yield from self._robots()
        yield from self._keys()
        if self._recording is not None:
            yield from _recording(self._recording)

    def _formation(self) -> Iterator[Metric]:
        seen = self._snapshot
        yield _gauge("formation_error_meters", "Sum over all edges", seen.formation_error)
        known, verdict = seen.known, seen.known_verdict
        yield _gauge("formation_known_error_meters", "Sum over the edges that are known", known.error)
        yield _gauge("formation_known_edges", "Edges that are known", float(known.known_edges))
        yield _gauge("formation_edges", "All edges", float(known.edges))
        yield _gauge(
            "formation_known_converged", "1 if the known edges have stayed under the bound",
            float(verdict.converged),
        )  # fmt: skip
        yield _gauge("formation_error_true_meters", "The same from ground truth", seen.formation_error_true)
        yield _gauge("formation_elapsed_seconds", "Since the error was first known", seen.elapsed)
        yield _gauge(
            "formation_settled_seconds", "When the error fell under the bound for good", seen.settled_at
        )
        yield _gauge("formation_converged", "1 if it has stayed there", float(seen.converged))
        mode = GaugeMetricFamily("formation_mode", "1 for what the leader orders", labels=["mode"])
        for one in get_args(Mode):
            mode.add_metric([one], float(one == seen.mode))
        yield mode
        shape = GaugeMetricFamily("formation_shape", "1 for the shape in force", labels=["shape"])
        shape.add_metric([seen.shape], 1.0)
        yield shape
        yield from _placed_shape(seen)
        yield from _leading(seen)
        rejected = CounterMetricFamily(
            "formation_messages_rejected",
            "Messages that are not what they should be",
            labels=["key", "reason"],
        )
        for what, count in seen.rejected.items():
            key, _, reason = what.partition(": ")
            rejected.add_metric([key, reason], count)
        yield rejected

    def _edges(self) -> Iterator[Metric]:
        family = GaugeMetricFamily(
            "formation_edge_error_meters", "Measured less desired displacement", labels=["robot", "edge"]
        )
        for (robot, neighbour), error in self._snapshot.edges.items():
            if error is not None:
                family.add_metric([robot, f"{robot}-{neighbour}"], error)
        yield family

    def _robots(self) -> Iterator[Metric]:
        for name, what, of in ROBOT:
            family = GaugeMetricFamily(f"formation_robot_{name}", what, labels=["robot"])
            for robot, metrics in self._snapshot.robots.items():
                if (value := of(metrics)) is not None:
                    family.add_metric([robot], value)
            yield family
        state = GaugeMetricFamily(
            "formation_robot_state", "1 for what it says of itself", labels=["robot", "state"]
        )
        for robot, metrics in self._snapshot.robots.items():
            state.add_metric([robot, metrics.shown], 1.0)
        yield state

    def _keys(self) -> Iterator[Metric]:
        keys = [
            (robot, key, metrics)
            for robot, one in self._snapshot.robots.items()
            for key, metrics in one.keys.items()
            if metrics.count
        ]
        received = CounterMetricFamily("formation_messages_received", "Received", labels=["robot", "key"])
        missed = CounterMetricFamily(
            "formation_messages_missed",
            "Periods without a message: lost, or skipped",
            labels=["robot", "key"],
        )
        for robot, key, metrics in keys:
            received.add_metric([robot, key], metrics.count)
            missed.add_metric([robot, key], metrics.missed)
        yield from (received, missed)
        for name, what, of in KEY:
            family = GaugeMetricFamily(f"formation_key_{name}", what, labels=["robot", "key"])
            for robot, key, metrics in keys:
                if (value := of(metrics)) is not None:
                    family.add_metric([robot, key], value)
            yield family


def _placed_shape(seen: Snapshot) -> Iterator[Metric]:
    """Yield the wanted shape and the current one."""
    wish, now = seen.wish, seen.placed_shape
    rotation = "counter-clockwise; of a shape that turns with the leader, from its heading"
    yield _gauge(
        "formation_rotation_radians", f"Ordered rotation, {rotation}", wish.rotation if wish else None
    )
    yield _gauge("formation_scale_ratio", "Ordered scale", wish.scale if wish else None)
    yield _gauge(
        "formation_shape_rotation_radians",
        "Rotation by now, from the world's x",
        now.rotation if now else None,
    )
    yield _gauge("formation_shape_scale_ratio", "Scale by now", now.scale if now else None)
    share = GaugeMetricFamily(
        "formation_shape_share_ratio", "Share of a shape in the present mix", labels=["shape"]
    )
    for shape, part in now.mix if now else ():
        share.add_metric([shape], part)
    yield share
    yield _gauge("formation_shape_formed", "1 once the shape is where it is wanted", float(seen.formed))


def _leading(seen: Snapshot) -> Iterator[Metric]:
    """Yield the leader, its term, and the candidates."""
    leader = GaugeMetricFamily("formation_leader_info", "1 for the process that leads", labels=["leader"])
    if seen.leads is not None:
        leader.add_metric([seen.leads], 1.0)
    yield leader
    term = seen.lead.term * 1e-9 if seen.lead else None
    yield _gauge("formation_leader_term_seconds", "When the term began, by the leader's clock", term)
    yield _gauge("formation_leader_waits", "1 while the leader waits for robots", float(bool(seen.waits)))
    state = GaugeMetricFamily(
        "formation_candidate_state", "1 for what a process that may lead does", labels=["candidate", "state"]
    )
    for name, one in seen.candidates.items():
        state.add_metric([name, one.state], 1.0)
    yield state


def _recording(recording: Mapping[str, Any]) -> Iterator[Metric]:
    yield _gauge("formation_recording_bytes", "Size of the recording", recording.get("bytes"))
    yield _gauge("formation_recording_seconds", "Length of the recording", recording.get("seconds"))
    yield _gauge("formation_recording_failed", "1 if it is not", float(recording.get("failure") is not None))


def _gauge(name: str, what: str, value: float | None) -> Metric:
    family = GaugeMetricFamily(name, what)
    if value is not None:
        family.add_metric([], value)
    return family
