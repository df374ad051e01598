from __future__ import annotations

import cmath
import json
import math
from dataclasses import replace
from typing import Any

import pytest

from formation.mission.file import load
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.web.frames import FIELDS, event, frame, hello
from formation.protocol.order import Slots
from tests.support.monitored import EPOCH, Fleet, command, now, receive, status, with_standbys

MISSION = load("six_robots")


def received(fleet: Fleet, *, without: str = "", truths: bool = False) -> Metrics:
    samples = fleet.positions(10.0, 11.0, without=without)
    for name in fleet.mission.followers if truths else ():
        samples += [fleet.truth(name, time, turned=-0.25) for time in fleet.times(name, 10.0, 11.0)]
    metrics = Metrics(fleet.mission)
    receive(metrics, sorted(samples, key=lambda one: one.arrived))
    metrics.observe(now(11.0))
    return metrics


def rows(one: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """A frame's rows by robot and by column."""
    return {
        name: dict(zip(FIELDS, row, strict=True)) for name, row in zip(MISSION.names, one["r"], strict=True)
    }


def test_hello_contains_mission_and_robot_constants() -> None:
    reported = hello(MISSION, live=True, control=False, version="1.2.3")
    assert reported.items() >= {
        "live": True, "control": False, "mission": "six-robots", "law": "field",
        "settled": MISSION.settled, "version": "1.2.3", "fields": list(FIELDS),
    }.items()  # fmt: skip
    assert [robot["name"] for robot in reported["robots"]] == list(MISSION.names)
    assert [robot["leader"] for robot in reported["robots"]] == [True] + 5 * [False]
    second = MISSION.robots["robot2"]
    assert reported["robots"][1] == {
        "name": "robot2", "leader": False, "max_speed": second.max_speed, "rate": second.rate,
        "max_turn_rate": second.max_turn_rate, "offset": second.control_point_offset,
    }  # fmt: skip
    assert reported["robots"][0]["offset"] == 0.0
    assert hello(MISSION.under("paper"), live=False, control=False, version="")["law"] == "paper"


def test_edges_and_shapes_use_the_order_of_robots() -> None:
    reported = hello(MISSION, live=True, control=False, version="")
    names = [(MISSION.names[i], MISSION.names[j]) for i, j in reported["edges"]]
    assert names == [(one, other) for one in MISSION.names for other in MISSION.robots[one].neighbours]
    assert set(reported["shapes"]) == set(MISSION.shapes)
    assert reported["shapes"]["wedge"][0] == [0.0, 0.0]
    assert tuple(reported["shapes"]["wedge"][2]) == MISSION.shapes["wedge"]["robot3"]
    snapshot = Metrics(MISSION).snapshot(now(0.0))
    assert names == [tuple(edge) for edge in snapshot.edges]  # a frame's errors have the same order


def test_hello_contains_simulated_posts_and_walls() -> None:
    reported = hello(load("posts"), live=True, control=False, version="")
    assert reported["posts"][1] == [2.6, -0.4, 0.06]
    assert reported["walls"] == [[3.4, -1.2, 5.0, -0.45]]


def test_frame_shows_all_robots_at_one_moment() -> None:
    fleet = Fleet(away=lambda robot, _: 0.25j if robot == "robot3" else 0j)
    metrics = received(fleet)
    one = frame(MISSION, metrics, now(11.0))
    moment = metrics.placed(now(11.0))[0] - EPOCH
    assert (one["t"], one["mode"], one["shape"]) == (11.0 + EPOCH, "run", "hexagon")
    for name, row in rows(one).items():
        point = fleet.point(name, moment)
        assert complex(row["point_x"], row["point_y"]) == pytest.approx(point, abs=1e-3)
        centre = point - (0.0 if name == "robot1" else 0.2) * cmath.rect(1.0, 0.5)
        assert complex(row["x"], row["y"]) == pytest.approx(centre, abs=1e-3)
        assert row["heading"] == pytest.approx(0.5, abs=1e-3)
        away = 0.25j if name == "robot3" else 0j
        assert complex(row["slot_x"], row["slot_y"]) == pytest.approx(point - away, abs=2e-3)
    errors = dict(zip(metrics.snapshot(now(11.0)).edges, one["e"], strict=True))
    assert {edge: error for edge, error in errors.items() if error} == {
        edge: pytest.approx(0.25, abs=1e-3) for edge in errors if "robot3" in edge
    }
    assert one["error"] == pytest.approx(sum(one["e"]), abs=1e-3)


def test_frame_values_are_in_their_columns() -> None:
    metrics = received(Fleet())
    receive(
        metrics, [command("robot4", 10.98, -0.75, 0.3), status("robot4", 10.9, "hold", "the leader holds")]
    )
    row = rows(frame(MISSION, metrics, now(11.0)))["robot4"]
    assert (row["speed"], row["turn_rate"]) == (-0.75, 0.3)
    assert (row["speed_share"], row["turn_rate_share"]) == (0.5, 0.2)
    assert (row["state"], row["reason"]) == ("hold", "the leader holds")
    assert row["rate"] == pytest.approx(20.0, abs=0.1)
    assert 0.0 <= row["age"] < 0.05
    assert row["loss"] == 0.0
    assert (row["health"], row["health_why"]) == (0.6, "hold: the leader holds")
    assert row["error"] == 0.0


def test_frame_shows_ground_truth_if_known() -> None:
    row = rows(frame(MISSION, received(Fleet(), truths=True), now(11.0)))["robot2"]
    assert row["heading_error"] == pytest.approx(0.25, abs=1e-3)
    true_centre = complex(row["true_x"], row["true_y"])
    point = complex(row["point_x"], row["point_y"])
    assert point - true_centre == pytest.approx(0.2 * cmath.rect(1.0, 0.25), abs=5e-3)
    without = rows(frame(MISSION, received(Fleet()), now(11.0)))["robot2"]
    assert (without["true_x"], without["true_y"], without["heading_error"]) == (None, None, None)


def test_unknown_values_are_null_instead_of_old() -> None:
    one = frame(MISSION, received(Fleet(), without="robot5"), now(11.0))
    row = rows(one)["robot5"]
    assert {row[key] for key in ("x", "y", "heading", "point_x", "point_y", "age", "rate", "loss")} == {None}
    assert row["slot_x"] is not None  # where it should be is known
    assert row["health"] == 0.0
    assert one["error"] is None
    assert one["known"][1:4] == [6, 9, "6 of 9 edges; 3 unknown (nothing from robot5 yet)"]
    later = rows(frame(MISSION, received(Fleet()), now(13.0)))
    assert {row["x"] for row in later.values()} == {None}
    assert {row["slot_x"] for row in later.values()} == {None}
    assert all(row["age"] > 1.9 for row in later.values())


def test_frame_without_any_message_is_complete() -> None:
    one = frame(MISSION, Metrics(MISSION), now(0.0))
    assert (one["error"], one["true"], one["settled_at"], one["mode"]) == (None, None, None, None)
    assert one["elapsed"] == 0.0
    assert {row["state"] for row in rows(one).values()} == {"unseen"}
    assert len(one["e"]) == 9
    json.dumps(one, allow_nan=False)


def test_frame_contains_given_recording_and_replay() -> None:
    recording = {"path": "a.mcap", "bytes": 5, "seconds": 1.0, "failure": None}
    replay = {"t": 1.0, "start": 0.0, "end": 2.0, "speed": 1.0, "paused": True}
    one = frame(MISSION, Metrics(MISSION), now(0.0), recording=recording, replay=replay)
    assert (one["recording"], one["replay"]) == (recording, replay)
    assert "replay" not in frame(MISSION, Metrics(MISSION), now(0.0))


def test_frame_of_given_snapshot_equals_frame_without_it() -> None:
    metrics = received(Fleet())
    again = frame(MISSION, metrics, now(11.0), snapshot=metrics.snapshot(now(11.0)))
    assert again == frame(MISSION, metrics, now(11.0))


def test_frame_numbers_have_at_most_four_decimals() -> None:
    fleet = Fleet(away=lambda robot, _: complex(0.0123456789, 0) if robot == "robot3" else 0j)
    one = frame(MISSION, received(fleet), now(11.0))
    values = [value for row in one["r"] for value in row if isinstance(value, float)]
    assert values == [round(value, 4) for value in values]
    assert len(json.dumps(one, separators=(",", ":"))) < 200 * len(MISSION.names)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_become_null(value: float) -> None:
    metrics = received(Fleet())
    snapshot = metrics.snapshot(now(11.0))
    strange = replace(snapshot.robots["robot2"], speed=value, heading_error=value)
    snapshot = replace(snapshot, formation_error=value, robots={**snapshot.robots, "robot2": strange})
    one = frame(MISSION, metrics, now(11.0), snapshot=snapshot)
    json.dumps(one, allow_nan=False)
    assert (one["error"], rows(one)["robot2"]["speed"]) == (None, None)


def test_event_is_encoded_with_its_number() -> None:
    assert event(7, Event(1001.23456, 30, "robot2", "stopped", "no beat")) == {
        "n": 7, "at": 1001.235, "level": 30, "robot": "robot2", "kind": "stopped", "text": "no beat",
    }  # fmt: skip


def turning(time: float) -> dict[str, Any]:
    """Order at `time`: between the hexagon and a wedge that is rotated and scaled."""
    part = min(max((time - 10.0) / 2.0, 0.0), 0.9)
    slots = Slots(mix={"hexagon": 1.0 - part, "wedge": part}, rotation=part, scale=1.0 + part)
    return {"shape": "wedge", "rotation": 1.2, "scale": 2.0, "slots": slots}


def test_frame_slots_are_correct_during_shape_transition() -> None:
    one = frame(MISSION, received(Fleet(wants=turning)), now(11.0))
    for row in rows(one).values():
        slot, point = complex(row["slot_x"], row["slot_y"]), complex(row["point_x"], row["point_y"])
        assert slot == pytest.approx(point, abs=2e-3)
    assert (one["shape"], one["rotation"], one["scale"], one["forming"]) == ("wedge", 1.2, 2.0, True)
    assert (one["settled_at"], one["converged"]) == (None, False)


def test_frame_names_leader_only_with_standbys() -> None:
    plain = frame(MISSION, received(Fleet()), now(11.0))
    assert not {"c", "leads", "since", "rotation", "scale", "forming", "waits"} & plain.keys()
    mission = with_standbys()
    metrics = received(Fleet(mission, term=64 * 10 + 1))
    receive(metrics, [status("spare1", 10.9, "run", ""), status("robot1", 10.9, "standby", "spare1 leads")])
    one = frame(mission, metrics, now(11.0))
    reported = hello(mission, live=True, control=False, version="")
    assert reported["candidates"] == ["robot1", "spare1", "spare2"]
    assert one["leads"] == "spare1"
    assert [row[:2] for row in one["c"]] == [
        ["standby", "spare1 leads"], ["leads", ""], ["unseen", "no status yet"],
    ]  # fmt: skip
