from __future__ import annotations

from formation.messages import Diagnostics, Number, decode
from formation.mission_file import load, parse, read
from formation.topics import CMD_VEL, DIAGNOSTICS, ERROR, GROUND_TRUTH, RELATIVE, SCAN, STATUS
from monitor.core import Monitor
from monitor.keys import watched
from tests.monitor.fleet import Fleet, now


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
    assert {out.key for out in outbox} == {DIAGNOSTICS.key()}
    (message,) = (decode(Diagnostics, out.payload) for out in outbox)
    assert message.statuses[0].values["error"] == "unknown"


def test_no_key_that_it_publishes_is_a_robots() -> None:
    assert [key for _, key in Monitor(load("six_robots")).publications] == [
        "formation/error",
        "formation/diagnostics",
    ]


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
        assert {CMD_VEL.key(name), SCAN.key(name), GROUND_TRUTH.key(name)} <= set(keys)


def test_displacements_are_listened_to_where_robots_measure_them() -> None:
    text, name = read("six_robots")
    mission = parse(text.replace("rate = 20 ", 'measurement = "local"\nrate = 20 '), name)
    keys = set(Monitor(mission).subscriptions)
    assert {RELATIVE.key("robot4", "robot2"), RELATIVE.key("robot4", "robot3")} <= keys
    assert RELATIVE.key("robot4", "robot1") not in keys
    assert not [key for key in Monitor(load("six_robots")).subscriptions if "relative" in key]
