from __future__ import annotations

import json
import random

import pytest

from formation.mission.file import load
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.words import as_json
from formation.topics import ODOM, POSITION, SCAN
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, command, now, odometry, receive, status


def received(fleet: Fleet, *samples: Sample) -> Metrics:
    metrics = Metrics(fleet.mission)
    receive(metrics, list(samples))
    return metrics


def test_robot_with_wrong_clock_is_still_compared() -> None:
    fleet = Fleet()
    slow = [fleet.position("robot4", time, clock=-900.0) for time in fleet.times("robot4", 10.0, 11.0)]
    metrics = received(fleet, *fleet.positions(10.0, 11.0, without="robot4"), *slow)
    snapshot = metrics.snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot4"].keys[POSITION.key("robot4")].clock == pytest.approx(900.0)


def test_forged_future_stamp_does_not_silence_honest_messages() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    metrics.process_sample(fleet.position("robot4", 11.01, clock=500.0), 11.01 + EPOCH)
    receive(metrics, fleet.positions(11.05, 12.0))
    assert metrics.observe(now(12.0)) == pytest.approx(0.0, abs=1e-9)
    assert metrics.rejections.by_reason == {"robot4/position: stamp is in the future": 1}


def test_a_replayed_position_is_refused_and_counted() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    old = fleet.positions(10.0, 10.5)
    receive(metrics, [Sample(s.key, s.payload, s.attachment, 11.0) for s in old if "robot3" in s.key])
    assert metrics.observe(now(11.0)) == pytest.approx(0.0, abs=1e-9)
    assert metrics.rejections.by_key[POSITION.key("robot3")] == 10


def test_recent_command_is_shown_with_share_of_limit() -> None:
    fleet = Fleet()
    metrics = received(fleet, command("robot2", 10.0, 0.75, -1.5))
    robot = metrics.snapshot(now(10.1)).robots["robot2"]
    assert (robot.speed, robot.turn_rate) == (0.75, -1.5)
    assert (robot.speed_share, robot.turn_share) == (0.5, 1.0)
    assert metrics.snapshot(now(11.0)).robots["robot2"].speed is None


def test_a_robot_that_takes_stamped_twists_is_read_as_such() -> None:
    mission = load("turtlebot3_pair")
    metrics = Metrics(mission)
    follower = mission.followers[0]
    stamped = mission.robots[follower].cmd_vel == "twist_stamped"
    receive(metrics, [command(follower, 10.0, 0.1, 0.2, stamped=stamped)])
    assert metrics.snapshot(now(10.1)).robots[follower].speed == 0.1
    receive(metrics, [command(follower, 10.1, 0.2, 0.2, stamped=not stamped)])
    assert sum(metrics.rejections.by_key.values()) == 1


def test_state_and_reason_come_from_status_until_silent() -> None:
    fleet = Fleet()
    metrics = received(fleet, status("robot2", 10.0, "hold", "odometry silent for 0.20 s"))
    robot = metrics.snapshot(now(11.0)).robots["robot2"]
    assert (robot.state, robot.reason) == ("hold", "odometry silent for 0.20 s")
    robot = metrics.snapshot(now(12.0)).robots["robot2"]
    assert (robot.state, robot.reason) == ("silent", "no status for 2.0 s")


def test_rate_age_count_and_missed_periods_are_of_each_key() -> None:
    fleet = Fleet()
    times = [10.0 + i / 20 for i in range(41) if i not in {15, 20, 21}]
    metrics = received(fleet, *[odometry("robot2", time) for time in times])
    key_metrics = metrics.snapshot(now(12.01)).robots["robot2"].keys[ODOM.key("robot2")]
    assert key_metrics.count == 38
    assert key_metrics.missed == 3
    assert key_metrics.rate == pytest.approx(20.0 * 30 / 33, rel=1e-6)
    assert key_metrics.age == pytest.approx(0.01, abs=1e-6)
    assert metrics.snapshot(now(14.0)).robots["robot2"].keys[ODOM.key("robot2")].rate == pytest.approx(
        31 / (33 / 20 + 2.0), rel=1e-6
    )


def test_a_pause_of_seconds_is_not_counted_as_missed_messages() -> None:
    metrics = received(Fleet(), odometry("robot2", 10.0), odometry("robot2", 15.0), odometry("robot2", 15.05))
    assert metrics.snapshot(now(15.1)).missed == 0


def test_malformed_messages_are_counted_by_reason_and_crash_nothing() -> None:
    fleet = Fleet()
    good = fleet.position("robot2", 10.0)
    bad = [
        good._replace(payload=b""),
        good._replace(payload=good.payload[:20]),
        good._replace(payload=good.payload.replace(good.payload[20:], b"\xff" * len(good.payload[20:]))),
        good._replace(key="robot9/position"),
        good._replace(key="robot2/odom"),
        fleet.position("robot1", 10.0)._replace(attachment=b"{}"),
        fleet.position("robot1", 10.05)._replace(attachment=b"\xff"),
    ]
    metrics = received(fleet, *bad)
    assert sum(metrics.rejections.by_key.values()) == len(bad)
    assert sum(metrics.rejections.by_reason.values()) == len(bad)
    assert metrics.rejections.by_key["elsewhere"] == 1
    assert metrics.snapshot(now(10.1)).formation_error is None


def test_reasons_do_not_multiply_however_much_rubbish_comes() -> None:
    metrics = Metrics(load("six_robots"))
    for i in range(10, 10_010):
        metrics.rejections.count(f"robot{i}/odom", f"speed is {i}.5e+20, must be a number")
        metrics.rejections.count("robot2/odom", f"speed is {i}.5e+20, must be a number")
    assert len(metrics.rejections.by_reason) <= 66
    assert metrics.rejections.by_reason["robot2/odom: speed is #, must be a number"] == 10_000


def test_a_key_without_a_codec_is_counted_all_the_same() -> None:
    metrics = received(Fleet(), Sample(SCAN.key("robot2"), b"anything", None, 10.0))
    assert metrics.snapshot(now(10.0)).robots["robot2"].keys[SCAN.key("robot2")].count == 1
    assert not metrics.rejections.by_key


def test_no_mutated_message_gets_past_the_codec_or_stops_the_monitor() -> None:
    fleet = Fleet()
    rng = random.Random(7)
    good = [
        *fleet.positions(10.0, 10.1),
        odometry("robot2", 10.0),
        command("robot2", 10.0, 0.1, 0.2),
        status("robot3", 10.0, "run", "fine"),
        fleet.truth("robot4", 10.0),
    ]
    metrics = received(fleet, *good)
    for i in range(5000):
        sample = rng.choice(good)
        payload, attachment = bytearray(sample.payload), bytearray(sample.attachment or b"{}")
        for data in (payload, attachment):
            for _ in range(rng.randrange(1, 6)):
                data[rng.randrange(len(data))] = rng.randrange(256)
        cut = rng.randrange(len(payload) + 1) if rng.random() < 0.3 else len(payload)
        at = 10.1 + i / 5000
        metrics.process_sample(Sample(sample.key, bytes(payload[:cut]), bytes(attachment), at), at + EPOCH)
        if i % 100 == 0:
            json.dumps(as_json(metrics.snapshot(now(at))), allow_nan=False)
    assert sum(metrics.rejections.by_key.values()) > 2000
