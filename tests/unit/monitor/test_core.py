from __future__ import annotations

import pytest

from formation.mission.file import load, parse, read
from formation.monitor.core import Monitor
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.metrics.words import line
from formation.ros2.messages import Diagnostics, Number, decode
from formation.topics import (
    ALIVE,
    CMD_VEL,
    DIAGNOSTICS,
    ERROR,
    EVENTS,
    GROUND_TRUTH,
    ODOM,
    POSE,
    RELATIVE,
    SCAN,
    STATUS,
)
from tests.support.monitored import Fleet, now


def test_the_error_is_published_ten_times_a_second_and_diagnostics_once() -> None:
    fleet = Fleet()
    monitor = Monitor(fleet.mission)
    samples = fleet.positions(10.0, 20.0)
    outbox = []
    for tick in range(500):
        mono = 10.0 + tick / 50
        inbox = [s for s in samples if mono - 0.02 < s.arrived <= mono]
        outbox += monitor.step(now(mono), inbox)
    errors = [decode(Number, out.payload).value for out in outbox if out.key == ERROR.key()]
    assert 98 <= len(errors) <= 100
    assert max(errors) < 1e-9
    assert sum(out.key == DIAGNOSTICS.key() for out in outbox) == 10


def test_an_error_that_is_not_known_is_not_published() -> None:
    fleet = Fleet()
    monitor = Monitor(fleet.mission)
    outbox = monitor.step(now(11.0), fleet.positions(10.0, 11.0, without="robot4"))
    assert {out.key for out in outbox} == {DIAGNOSTICS.key(), EVENTS.key()}
    (message,) = (decode(Diagnostics, out.payload) for out in outbox if out.key == DIAGNOSTICS.key())
    assert message.statuses[0].values["error"] == "unknown"


def test_no_key_that_it_publishes_is_a_robots() -> None:
    assert [one.key for one in OWN] == ["formation/error", "formation/diagnostics", "formation/events"]


def test_status_and_ground_truth_are_subscribed_to_last() -> None:
    topics = [one.topic for one in watched(load("six_robots"))]
    last = [topic in {STATUS, GROUND_TRUTH} for topic in topics]
    assert last == sorted(last)
    assert sum(last) == 6 + 5


def test_subscriptions_are_spelled_out_and_no_robot_is_missing() -> None:
    mission = load("two_chains")
    keys = Monitor(mission).subscriptions
    assert not [key for key in keys if "*" in key]
    assert len(set(keys)) == len(keys)
    for name in mission.followers:
        assert {ODOM.key(name), CMD_VEL.key(name), SCAN.key(name), STATUS.key(name)} <= set(keys)


def test_truth_is_subscribed_only_for_simulated_robots() -> None:
    mission = load("six_robots")
    monitor = Monitor(mission, ["robot3", "robot5"])
    assert monitor.truths == tuple((GROUND_TRUTH, GROUND_TRUTH.key(name)) for name in ("robot3", "robot5"))
    assert Monitor(mission).truths == ()
    assert not [key for key in monitor.subscriptions if GROUND_TRUTH.name in key]


def test_monitor_does_not_read_signs_of_life_for_the_watchdog() -> None:
    assert not [one for one in watched(load("six_robots")) if one.topic == ALIVE]


def test_without_simulated_robots_only_truth_is_missing() -> None:
    fleet = Fleet()
    monitor = Monitor(fleet.mission)
    monitor.step(now(11.0), fleet.positions(10.0, 11.0))
    snapshot = monitor.metrics.snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.formation_error_true is None
    assert {robot.heading_error for robot in snapshot.robots.values()} == {None}
    assert (snapshot.missed, dict(snapshot.rejected)) == (0, {})
    assert "true" not in line(snapshot)


def test_poses_are_listened_to_where_a_camera_finds_the_robots() -> None:
    text, name = read("six_robots")
    mission = parse(text.replace("rate = 20 ", 'localisation = "external"\nrate = 20 '), name)
    assert {POSE.key(follower) for follower in mission.followers} <= set(Monitor(mission).subscriptions)
    assert not [key for key in Monitor(load("six_robots")).subscriptions if key.endswith(POSE.name)]


def test_displacements_are_listened_to_where_robots_measure_them() -> None:
    text, name = read("six_robots")
    mission = parse(text.replace("rate = 20 ", 'measurement = "local"\nrate = 20 '), name)
    keys = set(Monitor(mission).subscriptions)
    assert {RELATIVE.key("robot4", "robot2"), RELATIVE.key("robot4", "robot3")} <= keys
    assert RELATIVE.key("robot4", "robot1") not in keys
    assert not [key for key in Monitor(load("six_robots")).subscriptions if "relative" in key]
