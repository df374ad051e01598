from __future__ import annotations

import math

import pytest

from formation.mission.file import load, parse, read
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Edge
from formation.topics import POSITION
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, now, receive


def received(fleet: Fleet, *samples: Sample) -> Metrics:
    metrics = Metrics(fleet.mission)
    receive(metrics, list(samples))
    return metrics


def test_different_sampling_times_cause_no_formation_error() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    error = metrics.observe(now(11.0))
    assert error is not None
    assert error < 1e-9


def test_newest_samples_without_interpolation_show_false_error() -> None:
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


def test_formation_error_is_sum_of_edge_errors() -> None:
    fleet = Fleet(away=lambda robot, _: 0.3 + 0.4j if robot == "robot4" else 0j)
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
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
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    assert metrics.observe(now(11.0)) is not None
    receive(metrics, fleet.positions(11.05, 12.0, without="robot5"))
    snapshot = metrics.snapshot(now(12.0))
    unknown = {edge for edge, error in snapshot.edges.items() if error is None}
    assert unknown == {edge for edge in snapshot.edges if "robot5" in edge}
    assert snapshot.formation_error is None
    assert snapshot.robots["robot5"].error is None
    assert snapshot.robots["robot3"].error == pytest.approx(0.0, abs=1e-9)
    assert snapshot.robots["robot5"].age == pytest.approx(1.0, abs=0.06)


def test_robot_with_only_malformed_positions_counts_as_silent() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    rubbish = [Sample(POSITION.key("robot5"), b"\0\1\0\0", None, 11.0 + i / 20) for i in range(20)]
    receive(
        metrics, sorted(fleet.positions(11.05, 12.0, without="robot5") + rubbish, key=lambda s: s.arrived)
    )
    snapshot = metrics.snapshot(now(12.0))
    assert snapshot.edges["robot5", "robot3"] is None  # type: ignore[index]
    assert snapshot.edges["robot3", "robot2"] == pytest.approx(0.0, abs=1e-9)  # type: ignore[index]


def test_nothing_is_interpolated_across_a_gap() -> None:
    fleet = Fleet()
    samples = fleet.positions(10.0, 12.0)
    gap = [s for s in samples if s.key == POSITION.key("robot3") and 10.9 < s.arrived < 11.9]
    before = [s for s in samples if s not in gap and s.arrived < 11.93]
    metrics = received(fleet, *before)
    # robot3 has just been received again; the others' common moment lies in its gap
    late = Sample(*fleet.position("robot3", 11.945)[:3], 11.93)
    metrics.process_sample(late, 11.945 + EPOCH)
    assert metrics.observe(now(11.95)) is None
    receive(metrics, [s for s in samples if s.arrived >= 11.93 and s.key != POSITION.key("robot3")])
    receive(metrics, [fleet.position("robot3", 11.995)])
    assert metrics.observe(now(12.0)) is not None


def test_error_is_unknown_until_all_robots_have_sent() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    snapshot = metrics.snapshot(now(10.0))
    assert snapshot.formation_error is None
    assert snapshot.settled_at is None
    assert not snapshot.converged
    assert {robot.state for robot in snapshot.robots.values()} == {"unseen"}
    assert {robot.age for robot in snapshot.robots.values()} == {None}
    receive(metrics, fleet.positions(10.0, 11.0, without="robot6"))
    assert metrics.observe(now(11.0)) is None


def test_the_true_error_needs_the_truth_of_every_follower() -> None:
    fleet = Fleet()
    truths = [fleet.truth(name, t) for name in fleet.mission.followers for t in fleet.times(name, 10.0, 11.0)]
    some = [sample for sample in truths if "robot6" not in sample.key]
    metrics = received(fleet, *fleet.positions(10.0, 11.0), *some)
    assert metrics.snapshot(now(11.0)).formation_error_true is None
    receive(metrics, [sample for sample in truths if "robot6" in sample.key])
    assert metrics.snapshot(now(11.0)).formation_error_true == pytest.approx(0.0, abs=1e-9)


def test_the_true_error_is_of_true_positions_not_of_believed_ones() -> None:
    fleet = Fleet()
    wandering = Fleet(away=lambda robot, _: 0.1j if robot == "robot2" else 0j)
    truths = [
        wandering.truth(name, t) for name in fleet.mission.followers for t in fleet.times(name, 10.0, 11.0)
    ]
    snapshot = received(fleet, *fleet.positions(10.0, 11.0), *truths).snapshot(now(11.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)
    # robot2 has edges to 1, and from 3 and 4
    assert snapshot.formation_error_true == pytest.approx(0.3, abs=1e-9)


def test_heading_error_is_estimate_minus_truth_if_known() -> None:
    fleet = Fleet()
    truths = [fleet.truth("robot3", t + 0.013, turned=0.2) for t in fleet.times("robot3", 10.0, 10.9)]
    robots = received(fleet, *fleet.positions(10.0, 11.0), *truths).snapshot(now(11.0)).robots
    assert robots["robot3"].heading_error == pytest.approx(-0.2, abs=1e-9)
    assert robots["robot4"].heading_error is None
    assert robots["robot1"].heading_error is None


def test_the_shape_and_the_mode_are_the_leaders_wish() -> None:
    text, name = read("six_robots")
    line = "robot2 = [-1.0, 0.0]\nrobot3 = [-2.0, 0.0]\nrobot4 = [-3.0, 0.0]\nrobot5 = [-4.0, 0.0]\n"
    mission = parse(
        text.replace("[robots.robot1]", f"[shapes.line]\n{line}robot6 = [-5.0, 0.0]\n[robots.robot1]"), name
    )
    fleet = Fleet(mission, shape="line", mode="hold")
    snapshot = received(fleet, *fleet.positions(10.0, 11.0)).snapshot(now(11.0))
    assert (snapshot.shape, snapshot.mode) == ("line", "hold")
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-9)


def test_an_unknown_shape_or_an_outdated_order_changes_nothing() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    beat, fleet.beat = fleet.beat, 0
    fleet.mode = "stop"
    receive(metrics, [fleet.position("robot1", 11.01)])  # the leader's position is news, its order is not
    fleet.beat, fleet.shape = beat, "hexagon"
    sample = fleet.position("robot1", 11.02)
    assert sample.attachment is not None
    metrics.process_sample(
        sample._replace(attachment=sample.attachment.replace(b"hexagon", b"banana")), 11.02 + EPOCH
    )
    snapshot = metrics.snapshot(now(11.05))
    assert (snapshot.shape, snapshot.mode) == ("hexagon", "run")
    assert snapshot.rejected == {"robot1/position: unknown shape": 1}


@pytest.mark.parametrize("mission", ["six_robots", "turtlebot3_pair", "two_chains"])
def test_every_shipped_mission_can_be_watched(mission: str) -> None:
    fleet = Fleet(load(mission), shape=load(mission).first_shape)
    metrics = received(fleet, *fleet.positions(10.0, 11.0))
    assert metrics.observe(now(11.0)) == pytest.approx(0.0, abs=1e-9)


def test_settling_time_counts_from_the_first_complete_error() -> None:
    # 1 m off at first, the error of four edges falls by e^{-t}: under 5 cm after ln(80) s
    fleet = Fleet(away=lambda robot, time: math.exp(-(time - 100.0)) if robot == "robot4" else 0j)
    metrics = Metrics(fleet.mission)
    samples = fleet.positions(100.0, 110.0)
    for tick in range(1, 101):
        until = 100.0 + tick / 10
        receive(metrics, [s for s in samples if until - 0.1 < s.arrived <= until])
        metrics.observe(now(until))
    snapshot = metrics.snapshot(now(110.0))
    assert snapshot.settled_at == pytest.approx(math.log(80.0), abs=0.25)
    assert snapshot.converged
    assert snapshot.elapsed == pytest.approx(9.95, abs=0.1)


def test_the_verdict_on_a_run_outlives_the_run() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    for second in range(10, 15):
        receive(metrics, fleet.positions(second, second + 0.95))
        metrics.observe(now(second + 1.0))
    after = metrics.snapshot(now(60.0))
    assert after.formation_error is None
    assert after.final_error == pytest.approx(0.0, abs=1e-9)
    assert after.converged


def test_a_robot_lost_before_the_end_means_not_converged() -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    for second in range(10, 20):
        receive(metrics, fleet.positions(second, second + 0.95, without="robot6" if second >= 15 else ""))
        metrics.observe(now(second + 1.0))
    after = metrics.snapshot(now(20.0))
    assert not after.converged
    assert after.settled_at is None
    assert after.final_error is None


def test_slow_robot_does_not_prevent_others_from_converging() -> None:
    text, name = read("six_robots")
    slow = text.replace("[robots.robot4]\n", "[robots.robot4]\nrate = 1\n")
    fleet = Fleet(parse(slow, name))
    metrics = Metrics(fleet.mission)
    samples = fleet.positions(10.0, 20.0)
    for tick in range(1, 101):
        until = 10.0 + tick / 10
        receive(metrics, [s for s in samples if until - 0.1 < s.arrived <= until])
        metrics.observe(now(until))
    snapshot = metrics.snapshot(now(20.0))
    assert snapshot.converged
    assert snapshot.settled_at == 0.0


def test_robots_are_shown_where_they_are_compared() -> None:
    fleet = Fleet(away=lambda robot, _: 0.25j if robot == "robot3" else 0j)
    metrics = received(fleet, *fleet.positions(10.0, 11.0, without="robot5"))
    moment, placed = metrics.placed(now(11.0))
    assert 10.9 < moment - EPOCH <= 11.0
    assert set(placed) == set(fleet.mission.names) - {"robot5"}
    for name, place in placed.items():
        assert place.moment == moment
        assert place.point == pytest.approx(fleet.point(name, moment - EPOCH), abs=1e-9)
    assert set(metrics.placed(now(11.0), truly=True)[1]) == {"robot1"}  # of the others no truth was received


@pytest.mark.parametrize("hours", [-1.0, 1.0])
def test_robots_are_still_seen_when_our_clock_was_set(hours: float) -> None:
    fleet = Fleet()
    metrics = Metrics(fleet.mission)
    receive(metrics, fleet.positions(10.0, 12.0))
    before = metrics.snapshot(now(12.0))
    for sample in fleet.positions(12.0, 14.0):
        metrics.process_sample(sample, sample.arrived + EPOCH + 3600.0 * hours)
    after = metrics.snapshot(now(14.0)._replace(wall=14.0 + EPOCH + 3600.0 * hours))
    assert before.formation_error == pytest.approx(0.0, abs=1e-6)
    assert after.formation_error == pytest.approx(0.0, abs=1e-6)
    assert not after.rejected
