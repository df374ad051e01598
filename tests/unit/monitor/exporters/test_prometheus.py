from __future__ import annotations

import re
from typing import Any

import pytest
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics.parser import text_string_to_metric_families as open_metrics
from prometheus_client.parser import text_string_to_metric_families as plain

from formation.monitor.exporters.prometheus import exposition
from formation.monitor.metrics.snapshot import Snapshot
from tests.support.monitored import Fleet, command, now, received, status

PLAIN, OPEN = "text/plain", "application/openmetrics-text; version=1.0.0"
RECORDING = {"path": "a.mcap", "bytes": 4711, "seconds": 12.5, "failure": None}
UNITS = r"(meters|seconds|radians|hertz|ratio|bytes|meters_per_second|radians_per_second)"
NO_UNIT = (
    r"(converged|known_converged|known_edges|edges"
    r"|mode|shape|shape_formed|leader_(info|waits)|(robot|candidate)_state|robot_(unavailable|stuck|avoiding|deadlocks|publishers)"
    r"|recording_failed|messages_(received|missed|rejected)(_total)?)"
)


def seen(*, without: str = "") -> Snapshot:
    fleet = Fleet(away=lambda robot, _: 0.25j if robot == "robot3" else 0j)
    commands = [command(name, 10.99, 0.75, 0.3) for name in ("robot4", "robot9")]
    positions = fleet.positions(10.0, 11.0, without=without)
    metrics = received(fleet, *positions, status("robot4", 10.9, "hold"), *commands)
    metrics.observe(now(11.0))
    return metrics.snapshot(now(11.0))


def families(snapshot: Snapshot, recording: Any = None) -> dict[str, Metric]:
    text, kind = exposition(snapshot, recording, PLAIN)
    assert kind.startswith("text/plain")
    return {family.name: family for family in plain(text.decode())}


def value(found: dict[str, Metric], name: str, **labels: str) -> float | None:
    """Value of the one sample of `formation_NAME` with these labels; None if there is none."""
    values = [one.value for one in found[f"formation_{name}"].samples if one.labels == labels]
    assert len(values) <= 1
    return values[0] if values else None


def test_exported_values_equal_the_snapshot() -> None:
    snapshot, found = seen(), families(seen())
    assert value(found, "error_meters") == pytest.approx(snapshot.formation_error)
    assert value(found, "converged") == 0.0
    assert value(found, "mode", mode="run") == 1.0
    assert value(found, "mode", mode="stop") == 0.0
    assert value(found, "shape", shape="hexagon") == 1.0
    assert value(found, "robot_speed_meters_per_second", robot="robot4") == 0.75
    assert value(found, "robot_speed_limit_ratio", robot="robot4") == 0.5
    assert value(found, "robot_state", robot="robot4", state="hold") == 1.0
    assert value(found, "edge_error_meters", robot="robot3", edge="robot3-robot2") == pytest.approx(0.25)


def test_every_key_has_counts_and_a_rate() -> None:
    found = families(seen())
    key = {"robot": "robot2", "key": "robot2/position"}
    assert value(found, "key_rate_hertz", **key) == pytest.approx(20.0, abs=0.5)
    received, missed = (
        {one.labels["key"]: one.value for one in found[f"formation_messages_{name}"].samples}
        for name in ("received", "missed")
    )
    assert (received["robot2/position"], missed["robot2/position"]) == (20.0, 0.0)
    assert "robot2/scan" not in received
    rejected = found["formation_messages_rejected"].samples
    assert [(sample.labels["reason"], sample.value) for sample in rejected] == [("unknown key", 1.0)]


def test_unknown_values_are_omitted_instead_of_zero() -> None:
    found = families(seen(without="robot5"))
    assert value(found, "error_meters") is None
    assert value(found, "error_true_meters") is None
    assert value(found, "edge_error_meters", robot="robot5", edge="robot5-robot4") is None
    assert value(found, "robot_position_age_seconds", robot="robot5") is None
    assert value(found, "robot_position_age_seconds", robot="robot4") is not None


def test_recording_is_exported_only_if_there_is_one() -> None:
    found = families(seen(), RECORDING)
    assert value(found, "recording_bytes") == 4711.0
    assert value(found, "recording_failed") == 0.0
    failed = families(seen(), {**RECORDING, "failure": "No space left on device"})
    assert value(failed, "recording_failed") == 1.0
    assert not [name for name in families(seen()) if "recording" in name]


def test_names_contain_units_and_everything_has_help() -> None:
    for name, family in families(seen(), RECORDING).items():
        assert re.fullmatch(rf"formation_(\w+_)?{UNITS}|formation_{NO_UNIT}", name), name
        assert family.documentation


def test_open_metrics_is_served_on_request() -> None:
    text, kind = exposition(seen(), RECORDING, OPEN)
    assert kind.startswith("application/openmetrics-text")
    names = {family.name for family in open_metrics(text.decode())}  # type: ignore[no-untyped-call]
    assert names == set(families(seen(), RECORDING))
