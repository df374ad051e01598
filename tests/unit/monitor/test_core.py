"""The monitor's core: what it subscribes to and publishes, and that its memory is bounded."""

from __future__ import annotations

import gc
import random
import tracemalloc
from collections.abc import Iterator
from unittest.mock import Mock

import pytest

from formation.mission.file import load, parse, read
from formation.monitor.core import MAX_EVENTS, Monitor
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.keys import given_stage, usual_stage, watched
from formation.monitor.process import MonitorLoop
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
    Topic,
)
from formation.transport import wiring
from formation.wire import Outgoing, Sample
from tests.support.missions import with_robots
from tests.support.monitored import EPOCH, Fleet, command, now, odometry, status
from tests.support.mutations import mutated


def test_error_is_published_at_10_hz_and_diagnostics_at_1_hz() -> None:
    monitor, samples, outbox = Monitor(Fleet().mission), Fleet().positions(10.0, 20.0), list[Outgoing]()
    for tick in range(500):
        mono = 10.0 + tick / 50
        outbox += monitor.step(now(mono), [s for s in samples if mono - 0.02 < s.arrived <= mono])
    errors = [decode(Number, out.payload).value for out in outbox if out.key == ERROR.key()]
    assert 98 <= len(errors) <= 100
    assert max(errors) < 1e-9
    assert sum(out.key == DIAGNOSTICS.key() for out in outbox) == 10


def test_unknown_error_is_not_published() -> None:
    outbox = Monitor(Fleet().mission).step(now(11.0), Fleet().positions(10.0, 11.0, without="robot4"))
    assert {out.key for out in outbox} == {DIAGNOSTICS.key(), EVENTS.key()}
    (message,) = (decode(Diagnostics, out.payload) for out in outbox if out.key == DIAGNOSTICS.key())
    assert message.statuses[0].values["error"] == "unknown"


def test_clock_event_is_recorded_before_messages_arrived_since() -> None:
    bus, recorder, sample = Mock(overflowed=0), Mock(failure=None), Fleet().positions(10.0, 11.0)[0]
    bus.drain.side_effect = ([], [sample])
    recorder.notices.return_value = ()
    times = iter((now(10.0), now(10.02)._replace(wall=10.02 + EPOCH - 60.0)))
    watch = MonitorLoop(Monitor(Fleet().mission), bus, recorder, Mock(), clock=lambda: next(times))
    pauses = watch.run(Mock(__bool__=lambda _: False), snapshots=False)
    next(pauses)
    recorder.write.reset_mock()
    next(pauses)
    (event, at), (second, _) = (call.args for call in recorder.write.call_args_list[:2])
    assert (event.key, at, second) == (EVENTS.key(), 10.02 + EPOCH - 60.0, sample)


def test_overflow_is_reported_with_number_of_messages() -> None:
    bus, monitor, moment = Mock(overflowed=0), Monitor(Fleet().mission), [10.0]
    bus.drain.return_value = []
    watch = MonitorLoop(monitor, bus, None, Mock(), clock=lambda: now(moment[0]))
    pauses = watch.run(Mock(__bool__=lambda _: False), snapshots=False)
    for overflowed in (0, 980, 990, 990):
        bus.overflowed, moment[0] = overflowed, moment[0] + 0.02
        next(pauses)
    moment[0] += 0.9
    texts = [one.event.text for one in monitor.events if one.event.kind == "recording"]
    assert texts == ["980 messages came while the monitor was busy: neither measured nor recorded"]


def test_status_and_ground_truth_are_subscribed_to_last() -> None:
    topics = [one.topic for one in watched(load("six_robots"))]
    last = [topic in {STATUS, GROUND_TRUTH} for topic in topics]
    assert last == sorted(last)
    assert sum(last) == 6 + 5


def test_subscriptions_name_every_follower_without_wildcards() -> None:
    mission = load("two_chains")
    keys = Monitor(mission).subscriptions
    assert "*" not in "".join(keys)
    assert len(set(keys)) == len(keys)
    assert set(keys) >= {
        topic.key(name) for name in mission.followers for topic in (ODOM, CMD_VEL, SCAN, STATUS)
    }


@pytest.mark.parametrize(
    ("keys", "topic", "some"),
    [
        ({"localisation": "external"}, POSE, {POSE.key(f"robot{k}") for k in range(2, 7)}),
        ({"measurement": "local"}, RELATIVE, {RELATIVE.key("robot4", f"robot{k}") for k in (2, 3)}),
    ],
)
def test_poses_and_displacements_are_subscribed_only_if_used(
    keys: dict[str, str], topic: Topic, some: set[str]
) -> None:
    subscribed = set(Monitor(with_robots("six_robots", **keys)).subscriptions)
    assert some <= subscribed
    assert RELATIVE.key("robot4", "robot1") not in subscribed
    assert not [one for one in watched(load("six_robots")) if one.topic in {topic, ALIVE}]


def test_truth_is_subscribed_only_for_simulated_robots() -> None:
    mission = load("six_robots")
    monitor = Monitor(mission, ["robot3", "robot5"])
    assert monitor.truth_topics == tuple(
        (GROUND_TRUTH, GROUND_TRUTH.key(name)) for name in ("robot3", "robot5")
    )
    assert Monitor(mission).truth_topics == ()
    assert not [key for key in monitor.subscriptions if GROUND_TRUTH.name in key]


@pytest.mark.parametrize(
    ("endpoints", "places"),
    [
        (["tcp/127.0.0.1:9"], dict.fromkeys(("robot1", "robot2"), "tcp/127.0.0.1:9")),
        (["tcp/desk:9#iface=lo"], dict.fromkeys(("robot1", "robot2"), "tcp/desk:9#iface=lo")),
        (["robot2=tls/desk:9?so_sndbuf=1"], {"robot2": "tls/desk:9?so_sndbuf=1"}),
        (["robot1=tcp/desk:8", "robot2=tcp/desk:9"], {"robot1": "tcp/desk:8", "robot2": "tcp/desk:9"}),
        (["robot1,robot2=tcp/desk:8"], dict.fromkeys(("robot1", "robot2"), "tcp/desk:8")),
    ],
)
def test_endpoint_applies_to_all_or_the_named_robots(endpoints: list[str], places: dict[str, str]) -> None:
    assert given_stage(load("turtlebot3_pair"), endpoints) == places


def test_robot_with_endpoint_in_mission_is_not_simulated() -> None:
    assert usual_stage(load("six_robots")) == wiring.endpoints(load("six_robots")).robots
    text, name = read("turtlebot3_pair")
    real = '[robots.robot1]\nrobot_endpoint = "tcp/127.0.0.1:7447"'
    mission = parse(text.replace("[robots.robot1]", real), name)
    assert list(usual_stage(mission)) == ["robot2"]


@pytest.mark.parametrize("name", ["robot9", "leader", ""])
def test_unknown_simulated_robot_is_refused_with_possible_names(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name!r} must be a follower of turtlebot3-pair: robot1, robot2"):
        given_stage(load("turtlebot3_pair"), [f"robot1,{name}=tcp/desk:9"])


def traffic(fleet: Fleet, rng: random.Random, start: float, end: float) -> Iterator[Sample]:
    """Messages of six robots, some of which are silent, and invalid messages."""
    gone = {name for name in fleet.mission.names if rng.random() < 0.2}
    for sample in fleet.positions(start, end):
        if sample.key.partition("/")[0] not in gone:
            yield sample
            yield command("robot2", sample.arrived, rng.random(), 0.1)
            yield odometry("robot3", sample.arrived)
        yield status("robot4", sample.arrived, rng.choice(("run", "hold", "stop")), f"at {sample.arrived}")
        if rng.random() < 0.3:
            yield sample._replace(payload=mutated(rng, [sample.payload]))
            yield sample._replace(attachment=rng.randbytes(20), key=f"robot{rng.randrange(12)}/position")


@pytest.mark.slow
def test_monitor_memory_does_not_grow_over_time() -> None:
    fleet, rng = Fleet(), random.Random(3)
    monitor = Monitor(fleet.mission)
    for number in range(MAX_EVENTS):
        monitor.note(Event(1000.0, 20, "", "operator", f"number {number} of those that are kept {'.' * 60}"))

    def watch(start: int, seconds: int) -> int:
        """Step the monitor for `seconds`; return the bytes that are allocated afterwards."""
        for second in range(start, start + seconds):
            samples = sorted(traffic(fleet, rng, second, second + 1.0), key=lambda sample: sample.arrived)
            for part in range(10):
                monitor.step(now(second + part / 10), samples[part::10])
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = watch(10, 10)
        after = watch(20, 30)
    finally:
        tracemalloc.stop()
    assert monitor.metrics.rejections.by_key
    assert len(monitor.events) == MAX_EVENTS
    assert after - before < 100_000  # of 8000 messages, each of which takes more than 100 bytes
