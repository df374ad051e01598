from __future__ import annotations

import json
from dataclasses import replace

from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import as_json, diagnostics, line
from formation.ros2.messages import MAX_PAYLOAD_BYTES, encode
from tests.support.monitored import Fleet, command, now, odometry, receive, status


def snapshot(fleet: Fleet | None = None, *, without: str = "") -> Snapshot:
    fleet = fleet or Fleet()
    metrics = Metrics(fleet.mission)
    receive(metrics, fleet.positions(10.0, 12.0, without=without))
    receive(metrics, [status(name, 11.5, "run", "fine") for name in fleet.mission.names])
    return metrics.snapshot(now(12.0))


def test_a_snapshot_is_json_before_anything_is_known() -> None:
    nothing = Metrics(Fleet().mission).snapshot(now(10.0))
    read_back = json.loads(json.dumps(as_json(nothing), allow_nan=False))
    assert read_back["formation_error"] is None
    assert read_back["elapsed"] == 0.0
    assert read_back["robots"]["robot2"]["age"] is None
    assert ["robot2", "robot1", None] in read_back["edges"]


def test_summary_line_names_unknown_edges_and_silent_robots() -> None:
    assert "error 0.0 mm" in line(snapshot())
    assert "6 run" in line(snapshot())
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    receive(metrics, fleet.positions(10.0, 12.0))
    receive(metrics, fleet.positions(12.05, 15.0, without="robot3"))
    text = line(metrics.snapshot(now(15.0)))
    assert "error 0.0 mm over 5 of 9 edges; 4 unknown (robot3 silent for 3 s)" in text
    text = line(metrics.snapshot(now(25.0)))
    assert "error unknown" in text
    assert "robot3 silent for 13.0 s" in text


def test_diagnostics_name_every_robot_its_edges_and_how_its_keys_arrive() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    receive(metrics, fleet.positions(10.0, 12.0))
    receive(metrics, [odometry("robot4", 12.0), command("robot4", 12.0, 0.3, 0.1)])
    (message,) = diagnostics(metrics.snapshot(now(12.0)), 1012.0)
    formation, *robots = message.statuses
    assert formation.values["error"] == "0.0000"
    assert [robot.hardware_id for robot in robots] == list(fleet.mission.names)
    values = robots[3].values
    assert (values["error.robot2"], values["error.robot3"]) == ("0.0000", "0.0000")
    assert (values["speed"], values["count.odom"], values["rate.position"]) == ("0.3000", "1", "20.0")


def test_a_silent_robots_diagnostics_are_stale() -> None:
    (message,) = diagnostics(snapshot(without="robot5"), 1012.0)
    levels = {status.name: status.level for status in message.statuses}
    assert levels["robot5: monitor"] == 3
    assert levels["formation: monitor"] == 1  # of the others the error is known
    assert levels["robot4: monitor"] == 0


def test_the_diagnostics_of_a_hundred_robots_fit_into_messages() -> None:
    few = snapshot()
    key_metrics = few.robots["robot4"]
    many = replace(few, robots={f"robot{i}": key_metrics for i in range(100)})
    messages = list(diagnostics(many, 1012.0))
    assert sum(len(message.statuses) for message in messages) == 101
    assert max(len(encode(message)) for message in messages) < MAX_PAYLOAD_BYTES
