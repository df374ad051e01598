from __future__ import annotations

from dataclasses import replace

import pytest

from formation.monitor.metrics.feed import freshness_limit
from formation.monitor.metrics.snapshot import RobotMetrics
from formation.monitor.web.frames import Health, health
from formation.topics import POSITION
from tests.support.monitored import EPOCH, Fleet, command, now, odometry, receive, received, status

SPEC = Fleet().mission.robots["robot3"]
KEY = POSITION.key("robot3")


def healthy() -> RobotMetrics:
    """Metrics of robot3 without faults."""
    fleet = Fleet()
    reported = status("robot3", 11.9, "run", "in formation control")
    metrics = received(fleet, *fleet.positions(10.0, 12.0), reported)
    return metrics.snapshot(now(12.0)).robots["robot3"]


def health_of(key_metrics: RobotMetrics, *, contested: bool = False) -> Health:
    return health("robot3", key_metrics, SPEC, contested=contested)


def test_robot_without_faults_has_full_health() -> None:
    assert health_of(healthy()) == Health(1.0, "")


def test_robot_never_received_has_zero_health() -> None:
    unseen = received(Fleet()).snapshot(now(12.0)).robots["robot3"]
    assert health_of(unseen) == Health(0.0, "nothing received yet")


def test_health_decreases_with_silence_to_zero() -> None:
    key_metrics = healthy()
    shares = [health_of(replace(key_metrics, age=age)).share for age in (0.2, 0.5, 0.8, 1.0, 60.0)]
    assert shares[0] == 1.0
    assert shares == sorted(shares, reverse=True)
    assert 0.0 < shares[2] < shares[1] < 1.0
    assert shares[3:] == [0.0, 0.0]
    assert health_of(replace(key_metrics, age=60.0)).why == "silent for 60.0 s"


def test_allowed_silence_depends_on_the_robots_rate() -> None:
    slow = SPEC.model_copy(update={"rate": 1.0})
    ages = (share * freshness_limit(slow.rate) for share in (1.0, 1.5, 2.0))
    shares = [health("robot3", replace(healthy(), age=age, rate=1.0), slow).share for age in ages]
    assert shares == [1.0, pytest.approx(0.5), 0.0]


def test_half_the_rate_gives_about_half_the_health() -> None:
    half = health_of(replace(healthy(), rate=10.0))
    assert half.share == pytest.approx(0.556, abs=0.001)
    assert half.why == "10.0 Hz of 20 Hz"
    assert health_of(replace(healthy(), rate=18.5)).share == 1.0
    assert health_of(replace(healthy(), rate=40.0)).share == 1.0


def test_only_recent_losses_reduce_health() -> None:
    positions = enumerate(Fleet().positions(10.0, 14.0))
    kept = [one for i, one in positions if i % 5 or not one.key.startswith("robot3")]
    metrics = received(Fleet(), *kept, status("robot3", 13.9, "run", "fine"))
    bad = metrics.snapshot(now(14.0)).robots["robot3"]
    assert 0.1 < (bad.keys[KEY].loss or 0.0) < 0.3
    assert health_of(bad).share < 0.7
    assert health_of(bad).why.endswith("% of its positions missed")
    receive(metrics, [*Fleet().positions(14.0, 17.0), status("robot3", 16.9, "run", "fine")])
    assert metrics.snapshot(now(17.0)).robots["robot3"].keys[KEY].loss == 0.0


def test_wrong_clock_reduces_health() -> None:
    key_metrics = healthy()
    wrong = replace(key_metrics, keys={**key_metrics.keys, KEY: key_metrics.keys[KEY]._replace(clock=900.0)})
    assert health_of(wrong) == Health(0.6, "its clock is 900.0 s off")


def test_rejected_messages_reduce_health_for_ten_seconds() -> None:
    fleet = Fleet()
    metrics = received(fleet, *fleet.positions(10.0, 12.0))
    assert metrics.snapshot(now(12.0)).robots["robot3"].rejected_age is None
    metrics.process_sample(command("robot3", 12.0, 0.1, 0.1)._replace(payload=b"rubbish"), 12.0 + EPOCH)
    assert metrics.snapshot(now(13.0)).robots["robot3"].rejected_age == 1.0
    assert health_of(replace(healthy(), rejected_age=1.0)) == Health(0.6, "messages rejected")
    assert health_of(replace(healthy(), rejected_age=10.0)) == Health(1.0, "")


def test_second_publisher_reduces_health() -> None:
    assert health_of(healthy(), contested=True) == Health(0.3, "it has a second publisher")


@pytest.mark.parametrize(
    ("state", "share"), [("run", 1.0), ("waiting", 0.7), ("hold", 0.6), ("stop", 0.5), ("silent", 0.5)]
)
def test_health_depends_on_the_robots_state(state: str, share: float) -> None:
    assert health_of(replace(healthy(), state=state)).share == share


def test_health_multiplies_faults_and_names_the_worst() -> None:
    key_metrics = replace(healthy(), state="hold", reason="no neighbour is fresh", rate=9.0)
    assert health_of(key_metrics).share == pytest.approx(0.3)
    assert health_of(key_metrics).why == "9.0 Hz of 20 Hz"
    assert 0.0 <= health_of(replace(key_metrics, age=0.9, rejected_age=1.0), contested=True).share < 0.05


def test_health_of_every_robot_is_between_0_and_1() -> None:
    fleet = Fleet()
    reported = odometry("robot2", 10.0), fleet.position("robot3", 10.0), status("robot4", 10.0, "run", "")
    metrics = received(fleet, *reported)
    for name, robot in metrics.snapshot(now(10.1)).robots.items():
        assert 0.0 <= health(name, robot, fleet.mission.robots[name]).share <= 1.0
