"""What the monitor computes from messages: errors, states, rates and rejections."""

from __future__ import annotations

import cmath
import json
import math
import random
from itertools import chain

import pytest

from formation.mission.file import load
from formation.monitor.metrics.feed import Feed
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Edge
from formation.monitor.metrics.trajectory import Placed, Trajectory
from formation.monitor.metrics.words import as_json
from formation.topics import ODOM, POSITION, SCAN
from formation.wire import BadMessage, Now, Sample
from tests.support.monitored import (
    EPOCH,
    Fleet,
    command,
    driven,
    now,
    odometry,
    receive,
    received,
    status,
)
from tests.support.mutations import mutated


def test_different_sampling_times_cause_no_formation_error() -> None:
    fleet = Fleet()
    assert (received(fleet, *fleet.positions(10.0, 11.0)).observe(now(11.0)) or 0.0) < 1e-9
    # without interpolation the same samples would give an error
    newest = {name: fleet.point(name, max(fleet.times(name, 10.0, 11.0))) for name in fleet.mission.names}
    slot = fleet.mission.slot
    naive = sum(
        abs(newest[j] - newest[i] - (slot(j) - slot(i)))
        for i in fleet.mission.names
        for j in fleet.mission.robots[i].neighbours
    )
    assert naive > 0.02


def test_formation_error_is_sum_of_edge_errors() -> None:
    fleet = Fleet(away=lambda robot, _: 0.3 + 0.4j if robot == "robot4" else 0j)
    snapshot = received(fleet, *fleet.positions(10.0, 11.0)).snapshot(now(11.0))
    # robot4 measures 2 and 3; 5 and 6 measure it
    wrong = {edge for edge, error in snapshot.edges.items() if error == pytest.approx(0.5, abs=1e-9)}
    assert wrong == {Edge(f"robot{i}", f"robot{j}") for i, j in ((4, 2), (4, 3), (5, 4), (6, 4))}
    assert len(snapshot.edges) == 9
    assert snapshot.formation_error == pytest.approx(2.0, abs=1e-9)
    for number, error in ((4, 1.0), (5, 0.5), (2, 0.0)):
        assert snapshot.robots[f"robot{number}"].error == pytest.approx(error, abs=1e-9)
    assert snapshot.robots["robot1"].error is None


@pytest.mark.parametrize("malformed", [False, True], ids=["silent", "malformed"])
def test_robot_without_valid_positions_makes_only_its_edges_unknown(malformed: bool) -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    assert metrics.observe(now(11.0)) is not None
    later = fleet.positions(11.05, 12.0, without="robot5")
    if malformed:
        later += [Sample(POSITION.key("robot5"), b"\0\1\0\0", None, 11.0 + i / 20) for i in range(20)]
    receive(metrics, sorted(later, key=lambda sample: sample.arrived))
    snapshot = metrics.snapshot(now(12.0))
    unknown = {edge for edge, error in snapshot.edges.items() if error is None}
    assert unknown == {edge for edge in snapshot.edges if "robot5" in edge}
    assert snapshot.formation_error is None
    assert snapshot.robots["robot5"].error is None
    assert snapshot.robots["robot3"].error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot5"].age == pytest.approx(1.0, abs=0.06)


def test_positions_are_not_interpolated_across_a_gap() -> None:
    fleet = Fleet()
    samples = fleet.positions(10.0, 12.0)
    gap = [s for s in samples if s.key == POSITION.key("robot3") and 10.9 < s.arrived < 11.9]
    metrics = received(fleet, *[s for s in samples if s not in gap and s.arrived < 11.93])
    # robot3 has just been received again; the others' common moment lies in its gap
    late = fleet.position("robot3", 11.945)._replace(arrived=11.93)
    metrics.process_sample(late, 11.945 + EPOCH)
    assert metrics.observe(now(11.95)) is None
    receive(metrics, [s for s in samples if s.arrived >= 11.93 and s.key != POSITION.key("robot3")])
    receive(metrics, [fleet.position("robot3", 11.995)])
    assert metrics.observe(now(12.0)) is not None


def test_error_is_unknown_until_all_robots_have_sent() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    snapshot = metrics.snapshot(now(10.0))
    assert (snapshot.formation_error, snapshot.settled_at, snapshot.converged) == (None, None, False)
    assert {(robot.state, robot.age) for robot in snapshot.robots.values()} == {("unseen", None)}
    receive(metrics, fleet.positions(10.0, 11.0, without="robot6"))
    assert metrics.observe(now(11.0)) is None


def test_true_error_needs_the_true_position_of_every_follower() -> None:
    fleet, wandering = Fleet(), Fleet(away=lambda robot, _: 0.1j if robot == "robot2" else 0j)
    truths = {
        name: [wandering.truth(name, time) for time in fleet.times(name, 10.0, 11.0)]
        for name in fleet.mission.followers
    }
    last = truths.pop("robot6")
    metrics = received(fleet, *fleet.positions(10.0, 11.0), *chain(*truths.values()))
    assert metrics.snapshot(now(11.0)).formation_error_true is None
    receive(metrics, last)
    snapshot = metrics.snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)  # of the positions that robots publish
    # robot2 has edges to 1, and from 3 and 4
    assert snapshot.formation_error_true == pytest.approx(0.3, abs=1e-9)


def test_heading_error_is_estimate_minus_truth_if_known() -> None:
    fleet = Fleet()
    turned = [fleet.truth("robot3", t + 0.013, turned=0.2) for t in fleet.times("robot3", 10.0, 10.9)]
    robots = received(fleet, *fleet.positions(10.0, 11.0), *turned).snapshot(now(11.0)).robots
    assert robots["robot3"].heading_error == pytest.approx(-0.2, abs=1e-9)
    assert (robots["robot4"].heading_error, robots["robot1"].heading_error) == (None, None)


def test_shape_and_mode_come_from_the_leaders_order() -> None:
    fleet = Fleet(shape="wedge", mode="hold")
    snapshot = received(fleet, *fleet.positions(10.0, 11.0)).snapshot(now(11.0))
    assert (snapshot.shape, snapshot.mode) == ("wedge", "hold")
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)


def test_unknown_shape_and_outdated_order_are_ignored() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    beat, fleet.beat = fleet.beat, 0
    fleet.mode = "stop"
    receive(metrics, [fleet.position("robot1", 11.01)])  # the leader's position is new, its order is not
    fleet.beat, fleet.shape = beat, "hexagon"
    sample = fleet.position("robot1", 11.02)
    banana = (sample.attachment or b"").replace(b"hexagon", b"banana")
    metrics.process_sample(sample._replace(attachment=banana), 11.02 + EPOCH)
    snapshot = metrics.snapshot(now(11.05))
    assert (snapshot.shape, snapshot.mode) == ("hexagon", "run")
    assert snapshot.rejected == {"robot1/position: unknown shape": 1}


@pytest.mark.parametrize("mission", ["turtlebot3_pair", "two_chains"])
def test_formation_error_is_zero_in_other_shipped_missions(mission: str) -> None:
    fleet = Fleet(load(mission), shape=load(mission).first_shape)
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    assert metrics.observe(now(11.0)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("hours", [-1.0, 1.0])
def test_monitor_clock_change_causes_no_error_or_rejection(hours: float) -> None:
    fleet, offset = Fleet(), EPOCH + 3600.0 * hours
    metrics = received(fleet, *fleet.positions(10.0, 12.0))
    assert metrics.snapshot(now(12.0)).formation_error == pytest.approx(0.0, abs=1e-6)
    for sample in fleet.positions(12.0, 14.0):
        metrics.process_sample(sample, sample.arrived + offset)
    after = metrics.snapshot(now(14.0)._replace(wall=14.0 + offset))
    assert after.formation_error == pytest.approx(0.0, abs=1e-6)
    assert not after.rejected


def test_error_is_followed_after_clock_set_between_messages() -> None:
    fleet = Fleet(away=lambda robot, time: 1.0 + 0j if robot == "robot4" and time > 12.0 else 0j)
    metrics = driven(fleet, 12.0)
    assert metrics.observe(Now(12.02, 12.02 + EPOCH - 60.0)) is None
    for sample in fleet.positions(12.0, 13.0):
        metrics.process_sample(sample, sample.arrived + EPOCH - 60.0)
        metrics.observe(Now(sample.arrived, sample.arrived + EPOCH - 60.0))
    final = metrics.snapshot(Now(13.0, 13.0 + EPOCH - 60.0)).final_error
    assert final is not None
    assert final > 1.0


def test_wrong_clock_of_a_robot_causes_no_error() -> None:
    fleet = Fleet()
    slow = [fleet.position("robot4", time, clock=-900.0) for time in fleet.times("robot4", 10.0, 11.0)]
    metrics = received(fleet, *fleet.positions(10.0, 11.0, without="robot4"), *slow)
    snapshot = metrics.snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot4"].keys[POSITION.key("robot4")].clock == pytest.approx(900.0)


def test_position_with_future_stamp_does_not_block_valid_ones() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    metrics.process_sample(fleet.position("robot4", 11.01, clock=500.0), 11.01 + EPOCH)
    receive(metrics, fleet.positions(11.05, 12.0))
    assert metrics.observe(now(12.0)) == pytest.approx(0.0, abs=1e-9)
    assert metrics.rejections.by_reason == {"robot4/position: stamp is in the future": 1}


def test_replayed_positions_are_rejected_and_counted() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    old = fleet.positions(10.0, 10.5)
    receive(metrics, [Sample(s.key, s.payload, s.attachment, 11.0) for s in old if "robot3" in s.key])
    assert metrics.observe(now(11.0)) == pytest.approx(0.0, abs=1e-9)
    assert metrics.rejections.by_key[POSITION.key("robot3")] == 10


def test_recent_command_is_shown_with_share_of_limit() -> None:
    metrics = received(Fleet(), command("robot2", 10.0, 0.75, -1.5))
    robot = metrics.snapshot(now(10.1)).robots["robot2"]
    assert (robot.speed, robot.turn_rate) == (0.75, -1.5)
    assert (robot.speed_share, robot.turn_share) == (0.5, 1.0)
    assert metrics.snapshot(now(11.0)).robots["robot2"].speed is None


def test_command_must_have_the_robots_message_type() -> None:
    mission = load("turtlebot3_pair")
    metrics, name = Metrics(mission), mission.followers[0]
    stamped = mission.robots[name].cmd_vel == "twist_stamped"
    receive(metrics, [command(name, 10.0, 0.1, 0.2, stamped=stamped)])
    assert metrics.snapshot(now(10.1)).robots[name].speed == 0.1
    receive(metrics, [command(name, 10.1, 0.2, 0.2, stamped=not stamped)])
    assert sum(metrics.rejections.by_key.values()) == 1


def test_repeated_status_shows_no_process_alive() -> None:
    fleet, one = Fleet(), status("robot2", 11.0, "run")
    metrics = received(fleet, *(one._replace(arrived=11.0 + 0.5 * number) for number in range(10)))
    assert metrics.snapshot(now(11.1)).robots["robot2"].state == "run"
    assert metrics.snapshot(now(15.6)).robots["robot2"].state == "silent"


@pytest.mark.parametrize(
    ("at", "expected"),
    [(11.0, ("hold", "odometry silent for 0.20 s")), (12.0, ("silent", "no status for 2.0 s"))],
)
def test_state_and_reason_come_from_status_until_silent(at: float, expected: tuple[str, str]) -> None:
    metrics = received(Fleet(), status("robot2", 10.0, "hold", "odometry silent for 0.20 s"))
    robot = metrics.snapshot(now(at)).robots["robot2"]
    assert (robot.state, robot.reason) == expected


def test_old_statuses_repeated_alternately_show_no_process_alive() -> None:
    old = [status("robot2", 10.0 + 0.5 * i, "run") for i in range(40)]
    repeated = [one._replace(arrived=31.0 + 0.5 * i) for i, one in enumerate(old[:2] * 8)]
    metrics = received(Fleet(), *old, *repeated)
    assert metrics.snapshot(now(39.0)).robots["robot2"].state == "silent"


def test_statuses_count_again_after_senders_clock_was_set_back() -> None:
    before = [status("robot2", 10.0 + 0.5 * i, "run") for i in range(40)]
    after = [status("robot2", 0.0 + 0.5 * i, "hold")._replace(arrived=30.0 + 0.5 * i) for i in range(40)]
    metrics = received(Fleet(), *before, *after)
    assert metrics.snapshot(now(49.6)).robots["robot2"].state == "hold"


def test_each_key_has_rate_age_count_and_missed_periods() -> None:
    times = [10.0 + i / 20 for i in range(41) if i not in {15, 20, 21}]
    metrics = received(Fleet(), *[odometry("robot2", time) for time in times])
    robots = [metrics.snapshot(now(at)).robots["robot2"] for at in (12.01, 14.0)]
    soon, later = (robot.keys[ODOM.key("robot2")] for robot in robots)
    assert (soon.count, soon.missed) == (38, 3)
    assert soon.rate == pytest.approx(20.0 * 30 / 33, rel=1e-6)
    assert soon.age == pytest.approx(0.01, abs=1e-6)
    assert later.rate == pytest.approx(31 / (33 / 20 + 2.0), rel=1e-6)


def test_second_sender_behind_the_first_causes_no_missed_messages() -> None:
    feed = Feed(20.0)
    for i in range(100):
        for stamp in (10.0 + i / 20, 9.8 + i / 20):
            feed.stamped(stamp, 10.0 + i / 20)
    assert feed.missed == 0


def test_long_pause_is_not_counted_as_missed_messages() -> None:
    metrics = received(Fleet(), odometry("robot2", 10.0), odometry("robot2", 15.0), odometry("robot2", 15.05))
    assert metrics.snapshot(now(15.1)).missed == 0


def test_malformed_messages_are_counted_by_key_and_reason() -> None:
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


def test_number_of_rejection_reasons_is_bounded() -> None:
    metrics = Metrics(load("six_robots"))
    for i in range(10, 10_010):
        metrics.rejections.count(f"robot{i}/odom", f"speed is {i}.5e+20, must be a number")
        metrics.rejections.count("robot2/odom", f"speed is {i}.5e+20, must be a number")
    assert len(metrics.rejections.by_reason) <= 66
    assert metrics.rejections.by_reason["robot2/odom: speed is #, must be a number"] == 10_000


def test_message_without_codec_is_counted() -> None:
    metrics = received(Fleet(), Sample(SCAN.key("robot2"), b"anything", None, 10.0))
    assert metrics.snapshot(now(10.0)).robots["robot2"].keys[SCAN.key("robot2")].count == 1
    assert not metrics.rejections.by_key


def test_mutated_messages_do_not_crash_metrics() -> None:
    fleet, rng = Fleet(), random.Random(7)
    good = [
        *fleet.positions(10.0, 10.1), odometry("robot2", 10.0), command("robot2", 10.0, 0.1, 0.2),
        status("robot3", 10.0, "run", "fine"), fleet.truth("robot4", 10.0),
    ]  # fmt: skip
    metrics = received(fleet, *good)
    for i in range(5000):
        sample = rng.choice(good)
        payload, attachment = (mutated(rng, [one]) for one in (sample.payload, sample.attachment or b"null"))
        at = 10.1 + i / 5000
        metrics.process_sample(Sample(sample.key, payload, attachment, at), at + EPOCH)
        if i % 100 == 0:
            json.dumps(as_json(metrics.snapshot(now(at))), allow_nan=False)
    assert sum(metrics.rejections.by_key.values()) > 2000


def along(*samples: tuple[float, complex, float], most: int = 100) -> Trajectory:
    """Trajectory of (moment, point, angle); it interpolates samples at most 0.3 s apart."""
    trajectory = Trajectory(most, 0.3)
    for moment, point, angle in samples:
        trajectory.add(Placed(moment, point, cmath.rect(1.0, angle)))
    return trajectory


def test_heading_is_interpolated_along_the_arc() -> None:
    placed = along((0.0, 0j, 3.0), (0.1, 1 + 2j, 3.4)).at(0.025)
    assert placed is not None
    assert placed.point == pytest.approx(0.25 + 0.5j)
    # through ±π, and of length one
    assert placed.heading == pytest.approx(cmath.rect(1.0, 3.1))


def test_trajectory_is_exact_at_samples_and_unknown_outside() -> None:
    trajectory = along((0.0, 0j, 0.0), (0.1, 1j, 0.0))
    assert trajectory.at(0.1) == Placed(0.1, 1j, 1 + 0j)
    assert trajectory.at(0.0) == Placed(0.0, 0j, 1 + 0j)
    assert [trajectory.at(0.1 + 1e-9), trajectory.at(-1e-9), along().at(0.0)] == [None] * 3
    assert along().latest == -math.inf


def test_distant_samples_are_not_interpolated() -> None:
    assert along((0.0, 0j, 0.0), (0.3, 1j, 0.0)).at(0.1) is not None
    assert along((0.0, 0j, 0.0), (0.31, 1j, 0.0)).at(0.1) is None


@pytest.mark.parametrize("moment", [0.1, 0.05])
def test_trajectory_refuses_samples_that_are_not_later(moment: float) -> None:
    trajectory = along((0.0, 0j, 0.0), (0.1, 1j, 0.0))
    with pytest.raises(BadMessage, match="not later"):
        trajectory.add(Placed(moment, 9j, 1 + 0j))
    assert trajectory.at(0.1) == Placed(0.1, 1j, 1 + 0j)


def test_trajectory_keeps_only_newest_samples() -> None:
    trajectory = along(*((i / 10, complex(i), 0.0) for i in range(1000)), most=10)
    assert trajectory.at(98.9) is None
    assert trajectory.at(99.0) is not None
