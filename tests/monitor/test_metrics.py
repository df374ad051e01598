from __future__ import annotations

import json
import math
import random

import pytest

from formation.mission_file import load, parse, read
from formation.topics import ODOM, POSITION, SCAN
from formation.wire import Sample
from monitor.figures import Edge
from monitor.metrics import Metrics
from monitor.report import as_json
from tests.monitor.fleet import EPOCH, Fleet, command, hear, now, odometry, status


def heard(fleet: Fleet, *samples: Sample) -> Metrics:
    metrics = Metrics(fleet.mission)
    hear(metrics, list(samples))
    return metrics


def test_robots_in_formation_that_are_sampled_at_different_times_show_no_error() -> None:
    fleet = Fleet()
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    error = metrics.observe(now(11.0))
    assert error is not None
    assert error < 1e-9


def test_comparing_newest_samples_as_they_are_would_show_an_error_where_there_is_none() -> None:
    # what the interpolation is for: the same fleet, without it
    fleet = Fleet()
    newest = {name: fleet.point(name, max(fleet.times(name, 10.0, 11.0))) for name in fleet.mission.names}
    slot = fleet.mission.slot
    naive = sum(
        abs(newest[j] - newest[i] - (slot(j) - slot(i)))
        for i in fleet.mission.names
        for j in fleet.mission.robots[i].neighbours
    )
    assert naive > 0.02


def test_the_error_is_the_sum_over_the_edges_and_each_robot_has_its_own() -> None:
    fleet = Fleet(away=lambda robot, _: 0.3 + 0.4j if robot == "robot4" else 0j)
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    snapshot = metrics.snapshot(now(11.0))
    # robot4 measures 2 and 3; 5 and 6 measure it
    wrong = {edge for edge, error in snapshot.edges.items() if error == pytest.approx(0.5, abs=1e-9)}
    assert wrong == {
        Edge("robot4", "robot2"),
        Edge("robot4", "robot3"),
        Edge("robot5", "robot4"),
        Edge("robot6", "robot4"),
    }
    assert len(snapshot.edges) == 9
    assert snapshot.formation_error == pytest.approx(2.0, abs=1e-9)
    assert snapshot.robots["robot4"].error == pytest.approx(1.0, abs=1e-9)
    assert snapshot.robots["robot5"].error == pytest.approx(0.5, abs=1e-9)
    assert snapshot.robots["robot2"].error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot1"].error is None


def test_a_silent_robot_makes_its_edges_unknown_and_no_others() -> None:
    fleet = Fleet()
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    assert metrics.observe(now(11.0)) is not None
    hear(metrics, fleet.positions(11.05, 12.0, without="robot5"))
    snapshot = metrics.snapshot(now(12.0))
    unknown = {edge for edge, error in snapshot.edges.items() if error is None}
    assert unknown == {edge for edge in snapshot.edges if "robot5" in edge}
    assert snapshot.formation_error is None
    assert snapshot.robots["robot5"].error is None
    assert snapshot.robots["robot3"].error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot5"].age == pytest.approx(1.0, abs=0.06)


def test_a_robot_whose_positions_are_all_malformed_is_as_good_as_silent() -> None:
    fleet = Fleet()
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    rubbish = [Sample(POSITION.key("robot5"), b"\0\1\0\0", None, 11.0 + i / 20) for i in range(20)]
    hear(metrics, sorted(fleet.positions(11.05, 12.0, without="robot5") + rubbish, key=lambda s: s.arrived))
    snapshot = metrics.snapshot(now(12.0))
    assert snapshot.edges["robot5", "robot3"] is None  # type: ignore[index]
    assert snapshot.edges["robot3", "robot2"] == pytest.approx(0.0, abs=1e-9)  # type: ignore[index]


def test_nothing_is_interpolated_across_a_gap() -> None:
    fleet = Fleet()
    samples = fleet.positions(10.0, 12.0)
    gap = [s for s in samples if s.key == POSITION.key("robot3") and 10.9 < s.arrived < 11.9]
    before = [s for s in samples if s not in gap and s.arrived < 11.93]
    metrics = heard(fleet, *before)
    # robot3 has just been heard again; the others' common moment lies in its gap
    late = Sample(*fleet.position("robot3", 11.945)[:3], 11.93)
    metrics.take(late, 11.945 + EPOCH)
    assert metrics.observe(now(11.95)) is None
    hear(metrics, [s for s in samples if s.arrived >= 11.93 and s.key != POSITION.key("robot3")])
    hear(metrics, [fleet.position("robot3", 11.995)])
    assert metrics.observe(now(12.0)) is not None


def test_nothing_is_known_before_everybody_has_spoken() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    snapshot = metrics.snapshot(now(10.0))
    assert snapshot.formation_error is None
    assert snapshot.settled_at is None
    assert not snapshot.converged
    assert {robot.state for robot in snapshot.robots.values()} == {"unseen"}
    assert {robot.age for robot in snapshot.robots.values()} == {None}
    hear(metrics, fleet.positions(10.0, 11.0, without="robot6"))
    assert metrics.observe(now(11.0)) is None


def test_the_true_error_needs_the_truth_of_every_follower() -> None:
    fleet = Fleet()
    truths = [fleet.truth(name, t) for name in fleet.mission.followers for t in fleet.times(name, 10.0, 11.0)]
    some = [sample for sample in truths if "robot6" not in sample.key]
    metrics = heard(fleet, *fleet.positions(10.0, 11.0), *some)
    assert metrics.snapshot(now(11.0)).formation_error_true is None
    hear(metrics, [sample for sample in truths if "robot6" in sample.key])
    assert metrics.snapshot(now(11.0)).formation_error_true == pytest.approx(0.0, abs=1e-9)


def test_the_true_error_is_of_true_positions_not_of_believed_ones() -> None:
    fleet = Fleet()
    wandering = Fleet(away=lambda robot, _: 0.1j if robot == "robot2" else 0j)
    truths = [
        wandering.truth(name, t) for name in fleet.mission.followers for t in fleet.times(name, 10.0, 11.0)
    ]
    snapshot = heard(fleet, *fleet.positions(10.0, 11.0), *truths).snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)
    # robot2 has edges to 1, and from 3 and 4
    assert snapshot.formation_error_true == pytest.approx(0.3, abs=1e-9)


def test_heading_error_is_the_estimate_less_the_truth_where_there_is_truth() -> None:
    fleet = Fleet()
    truths = [fleet.truth("robot3", t + 0.013, turned=0.2) for t in fleet.times("robot3", 10.0, 10.9)]
    robots = heard(fleet, *fleet.positions(10.0, 11.0), *truths).snapshot(now(11.0)).robots
    assert robots["robot3"].heading_error == pytest.approx(-0.2, abs=1e-9)
    assert robots["robot4"].heading_error is None
    assert robots["robot1"].heading_error is None


def test_a_robot_with_a_wrong_clock_is_still_compared_with_the_others() -> None:
    fleet = Fleet()
    slow = [fleet.position("robot4", time, clock=-900.0) for time in fleet.times("robot4", 10.0, 11.0)]
    metrics = heard(fleet, *fleet.positions(10.0, 11.0, without="robot4"), *slow)
    snapshot = metrics.snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot4"].keys[POSITION.key("robot4")].clock == pytest.approx(900.0)


def test_one_forged_stamp_from_the_future_does_not_silence_the_honest_ones() -> None:
    fleet = Fleet()
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    metrics.take(fleet.position("robot4", 11.01, clock=500.0), 11.01 + EPOCH)
    hear(metrics, fleet.positions(11.05, 12.0))
    assert metrics.observe(now(12.0)) == pytest.approx(0.0, abs=1e-9)
    assert metrics.rejections.by_reason == {"robot4/position: stamp is in the future": 1}


def test_a_replayed_position_is_refused_and_counted() -> None:
    fleet = Fleet()
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    old = fleet.positions(10.0, 10.5)
    hear(metrics, [Sample(s.key, s.payload, s.attachment, 11.0) for s in old if "robot3" in s.key])
    assert metrics.observe(now(11.0)) == pytest.approx(0.0, abs=1e-9)
    assert metrics.rejections.by_key[POSITION.key("robot3")] == 10


def test_the_shape_and_the_mode_are_the_leaders_wish() -> None:
    text, name = read("six_robots")
    line = "robot2 = [-1.0, 0.0]\nrobot3 = [-2.0, 0.0]\nrobot4 = [-3.0, 0.0]\nrobot5 = [-4.0, 0.0]\n"
    mission = parse(
        text.replace("[robots.robot1]", f"[shapes.line]\n{line}robot6 = [-5.0, 0.0]\n[robots.robot1]"), name
    )
    fleet = Fleet(mission, shape="line", mode="hold")
    snapshot = heard(fleet, *fleet.positions(10.0, 11.0)).snapshot(now(11.0))
    assert (snapshot.shape, snapshot.mode) == ("line", "hold")
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)


def test_an_unknown_shape_or_an_outdated_order_changes_nothing() -> None:
    fleet = Fleet()
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    beat, fleet.beat = fleet.beat, 0
    fleet.mode = "stop"
    hear(metrics, [fleet.position("robot1", 11.01)])  # the leader's position is news, its order is not
    fleet.beat, fleet.shape = beat, "hexagon"
    sample = fleet.position("robot1", 11.02)
    assert sample.attachment is not None
    metrics.take(sample._replace(attachment=sample.attachment.replace(b"hexagon", b"banana")), 11.02 + EPOCH)
    snapshot = metrics.snapshot(now(11.05))
    assert (snapshot.shape, snapshot.mode) == ("hexagon", "run")
    assert snapshot.rejected == {"robot1/position: unknown shape": 1}


def test_commands_are_shown_with_their_share_of_the_limit_while_they_are_news() -> None:
    fleet = Fleet()
    metrics = heard(fleet, command("robot2", 10.0, 0.75, -1.5))
    robot = metrics.snapshot(now(10.1)).robots["robot2"]
    assert (robot.speed, robot.turn_rate) == (0.75, -1.5)
    assert (robot.speed_share, robot.turn_share) == (0.5, 1.0)
    assert metrics.snapshot(now(11.0)).robots["robot2"].speed is None


def test_a_robot_that_takes_stamped_twists_is_read_as_such() -> None:
    mission = load("turtlebot3_pair")
    metrics = Metrics(mission)
    follower = mission.followers[0]
    stamped = mission.robots[follower].cmd_vel == "twist_stamped"
    hear(metrics, [command(follower, 10.0, 0.1, 0.2, stamped=stamped)])
    assert metrics.snapshot(now(10.1)).robots[follower].speed == 0.1
    hear(metrics, [command(follower, 10.1, 0.2, 0.2, stamped=not stamped)])
    assert sum(metrics.rejections.by_key.values()) == 1


def test_state_and_reason_are_the_agents_own_words_until_it_falls_silent() -> None:
    fleet = Fleet()
    metrics = heard(fleet, status("robot2", 10.0, "hold", "odometry silent for 0.20 s"))
    robot = metrics.snapshot(now(11.0)).robots["robot2"]
    assert (robot.state, robot.reason) == ("hold", "odometry silent for 0.20 s")
    robot = metrics.snapshot(now(12.0)).robots["robot2"]
    assert (robot.state, robot.reason) == ("silent", "no status for 2.0 s")


def test_rate_age_count_and_missed_periods_are_of_each_key() -> None:
    fleet = Fleet()
    times = [10.0 + i / 20 for i in range(41) if i not in {15, 20, 21}]
    metrics = heard(fleet, *[odometry("robot2", time) for time in times])
    figures = metrics.snapshot(now(12.01)).robots["robot2"].keys[ODOM.key("robot2")]
    assert figures.count == 38
    assert figures.missed == 3
    assert figures.rate == pytest.approx(20.0 * 30 / 33, rel=1e-6)
    assert figures.age == pytest.approx(0.01, abs=1e-6)
    assert metrics.snapshot(now(14.0)).robots["robot2"].keys[ODOM.key("robot2")].rate == pytest.approx(
        31 / (33 / 20 + 2.0), rel=1e-6
    )


def test_a_pause_of_seconds_is_not_counted_as_missed_messages() -> None:
    metrics = heard(Fleet(), odometry("robot2", 10.0), odometry("robot2", 15.0), odometry("robot2", 15.05))
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
    metrics = heard(fleet, *bad)
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
    metrics = heard(Fleet(), Sample(SCAN.key("robot2"), b"anything", None, 10.0))
    assert metrics.snapshot(now(10.0)).robots["robot2"].keys[SCAN.key("robot2")].count == 1
    assert not metrics.rejections.by_key


@pytest.mark.parametrize("mission", ["six_robots", "turtlebot3_pair", "two_chains"])
def test_every_shipped_mission_can_be_watched(mission: str) -> None:
    fleet = Fleet(load(mission), shape=load(mission).first_shape)
    metrics = heard(fleet, *fleet.positions(10.0, 11.0))
    assert metrics.observe(now(11.0)) == pytest.approx(0.0, abs=1e-9)


def test_settling_time_counts_from_the_first_complete_error() -> None:
    # 1 m off at first, the error of four edges falls by e^{-t}: under 5 cm after ln(80) s
    fleet = Fleet(away=lambda robot, time: math.exp(-(time - 100.0)) if robot == "robot4" else 0j)
    metrics = Metrics(fleet.mission)
    samples = fleet.positions(100.0, 110.0)
    for tick in range(1, 101):
        until = 100.0 + tick / 10
        hear(metrics, [s for s in samples if until - 0.1 < s.arrived <= until])
        metrics.observe(now(until))
    snapshot = metrics.snapshot(now(110.0))
    assert snapshot.settled_at == pytest.approx(math.log(80.0), abs=0.25)
    assert snapshot.converged
    assert snapshot.elapsed == pytest.approx(9.95, abs=0.1)


def test_the_verdict_on_a_run_outlives_the_run() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    for second in range(10, 15):
        hear(metrics, fleet.positions(second, second + 0.95))
        metrics.observe(now(second + 1.0))
    after = metrics.snapshot(now(60.0))
    assert after.formation_error is None
    assert after.final_error == pytest.approx(0.0, abs=1e-9)
    assert after.converged


def test_a_robot_lost_before_the_end_means_not_converged() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    for second in range(10, 20):
        hear(metrics, fleet.positions(second, second + 0.95, without="robot6" if second >= 15 else ""))
        metrics.observe(now(second + 1.0))
    after = metrics.snapshot(now(20.0))
    assert not after.converged
    assert after.settled_at is None
    assert after.final_error is None


def test_a_robot_that_speaks_once_a_second_does_not_keep_the_others_from_converging() -> None:
    text, name = read("six_robots")
    slow = text.replace("[robots.robot4]\n", "[robots.robot4]\nrate = 1\n")
    fleet = Fleet(parse(slow, name))
    metrics = Metrics(fleet.mission)
    samples = fleet.positions(10.0, 20.0)
    for tick in range(1, 101):
        until = 10.0 + tick / 10
        hear(metrics, [s for s in samples if until - 0.1 < s.arrived <= until])
        metrics.observe(now(until))
    snapshot = metrics.snapshot(now(20.0))
    assert snapshot.converged
    assert snapshot.settled_at == 0.0


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
    metrics = heard(fleet, *good)
    for i in range(5000):
        sample = rng.choice(good)
        payload, attachment = bytearray(sample.payload), bytearray(sample.attachment or b"{}")
        for data in (payload, attachment):
            for _ in range(rng.randrange(1, 6)):
                data[rng.randrange(len(data))] = rng.randrange(256)
        cut = rng.randrange(len(payload) + 1) if rng.random() < 0.3 else len(payload)
        at = 10.1 + i / 5000
        metrics.take(Sample(sample.key, bytes(payload[:cut]), bytes(attachment), at), at + EPOCH)
        if i % 100 == 0:
            json.dumps(as_json(metrics.snapshot(now(at))), allow_nan=False)
    assert sum(metrics.rejections.by_key.values()) > 2000
