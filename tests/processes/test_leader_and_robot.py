"""The leader and the simulated robots as real processes over real Zenoh."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from formation import order
from formation.bus import Bus, BusConfig
from formation.mailbox import Mailbox
from formation.messages import Diagnostics, Displacement, Odometry, Pose, Twist, decode, encode
from formation.mission_file import load, read
from formation.naming import Naming
from formation.order import OperatorReply, Order, Told
from formation.robot_bus import RobotBus
from formation.ros_names import address
from formation.topics import CMD_VEL, GROUND_TRUTH
from formation.wire import Sample
from tests.processes.bus_tools import until
from tests.processes.child import PATIENCE, Child, free_endpoint, started
from tests.processes.zenoh_admin import inspect

pytestmark = pytest.mark.processes
SIX = load("six_robots")


@contextmanager
def listening(endpoint: str, *keys: str) -> Iterator[Bus]:
    """A bus of the test's own, linked with the process under test."""
    with Bus(BusConfig(connect=(endpoint,))) as bus:
        for key in keys:
            bus.subscribe(key)
        yield bus


@contextmanager
def beside(endpoint: str, *keys: str) -> Iterator[tuple[RobotBus, Mailbox]]:
    """The test in the place of robot2's agent, and what it hears from the robot."""
    mailbox = Mailbox()
    with RobotBus((endpoint,), Naming.of(SIX, ["robot2"]), mailbox) as bus:
        for key in keys:
            bus.subscribe(address(key).topic, key)
        yield bus, mailbox


def heard(bus: Bus | Mailbox, enough: Callable[[Sequence[Sample]], Any]) -> list[Sample]:
    """What arrives until it is enough."""
    samples: list[Sample] = []
    deadline = time.monotonic() + PATIENCE
    while not enough(samples):
        assert bus.wait(deadline - time.monotonic()), f"only {len(samples)} samples came"
        samples += bus.drain()
    return samples


@contextmanager
def leader(endpoint: str, *arguments: str) -> Iterator[Child]:
    with started("leader", "six_robots", "-l", endpoint, *arguments) as child:
        assert child.event("ready") == {"event": "ready", "process": "leader robot1"}
        yield child


@contextmanager
def robot2(endpoint: str, *arguments: str) -> Iterator[Child]:
    with started("agent.robots", "six_robots", "--robot", "robot2", "-l", endpoint, *arguments) as child:
        assert child.event("ready") == {"event": "ready", "process": "robot robot2"}
        yield child


def ordered(sample: Sample) -> Order:
    told = order.decode(Told, sample.attachment or b"").order
    assert told is not None
    return told


def test_a_leader_goes_along_its_route_in_real_time_with_a_rising_beat() -> None:
    end = free_endpoint()
    with leader(end) as child, listening(end, "robot1/position") as bus:
        samples = heard(bus, lambda samples: len(samples) >= 30)
        child.signal(signal.SIGTERM)
    poses = [decode(Pose, sample.payload) for sample in samples]
    orders = [ordered(sample) for sample in samples]
    way = poses[-1].position - poses[0].position
    assert abs(way) / (poses[-1].stamp - poses[0].stamp) == pytest.approx(0.2, abs=1e-3)
    assert math.degrees(math.atan2(way.imag, way.real)) == pytest.approx(30.0, abs=1e-3)
    assert [one.beat for one in orders] == list(range(orders[0].beat, orders[0].beat + len(orders)))
    assert {(one.mode, one.shape) for one in orders} == {("run", "hexagon")}


def test_an_operator_stops_and_releases_a_leader_which_acknowledges() -> None:
    end = free_endpoint()
    with leader(end), listening(end, "robot1/position") as bus:
        heard(bus, len)
        modes = []
        for request in (b'{"do":"stop"}', b'{"do":"run"}', b'{"do":"release"}', b"nonsense"):
            (reply,) = bus.ask("robot1/order", request, timeout=PATIENCE)
            answer = order.decode(OperatorReply, reply.payload)
            bus.drain()
            after = heard(bus, lambda samples: len(samples) >= 2)
            modes.append((answer.ok, answer.mode, ordered(after[-1]).mode))
    assert modes == [
        (True, "stop", "stop"),
        (False, "stop", "stop"),
        (True, "run", "run"),
        (False, "run", "run"),
    ]


def test_the_last_words_of_a_leader_that_is_ended_are_a_hold() -> None:
    end = free_endpoint()
    with leader(end) as child, listening(end, "robot1/position", "robot1/status") as bus:
        heard(bus, len)
        child.signal(signal.SIGINT)
        summary = child.event("summary")
        samples = heard(bus, lambda samples: any(b"SIGINT" in sample.payload for sample in samples))
    last = [sample for sample in samples if sample.key == "robot1/position"][-1]
    assert ordered(last).mode == "hold"
    assert decode(Diagnostics, samples[-1].payload).statuses[0].values["reason"] == "SIGINT"
    assert ordered(last).beat == summary["published"]["robot1/position"]


def test_a_robot_goes_where_it_is_told_and_stands_when_it_is_told() -> None:
    end = free_endpoint()
    with robot2(end) as child, beside(end, "robot2/odom", "robot2/ground_truth") as (bus, box):
        bus.advertise(CMD_VEL, "robot2/cmd_vel")
        at_rest = newest_odometry(heard(box, odometry))
        assert at_rest is not None
        assert at_rest.position == -1.5 + 2.0j
        bus.publish("robot2/cmd_vel", encode(Twist(0.5, 0.0)))
        moving = heard(box, lambda samples: is_at(samples, 0.5) and len(samples) >= 40)
        bus.publish("robot2/cmd_vel", encode(Twist(0.0, 0.0)))
        stopped = newest_odometry(heard(box, lambda samples: is_at(samples, 0.0)))
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
    fast = [one for one in map(odometry_of, moving) if one is not None and one.speed == 0.5]
    seconds, way = fast[-1].stamp - fast[0].stamp, fast[-1].position - fast[0].position
    assert way == pytest.approx(0.5j * seconds, abs=1e-4)
    assert stopped is not None
    assert stopped.position.imag > fast[-1].position.imag
    assert summary["robot"]["received"] == {"robot2/cmd_vel": 2}
    said = summary["robot"]["published"]
    assert said["robot2/odom"] == said["robot2/ground_truth"]
    assert (summary["published"], summary["received"]) == ({}, {})


def test_what_is_no_command_moves_nothing_and_is_reported_at_the_end() -> None:
    end = free_endpoint()
    with robot2(end) as child, beside(end, "robot2/odom") as (bus, box):
        bus.advertise(CMD_VEL, "robot2/cmd_vel")
        heard(box, odometry)
        bus.publish("robot2/cmd_vel", b"\x00\x01\x00\x00 and too short")
        bus.publish("robot2/cmd_vel", encode(Twist(0.5, 0.0)).replace(b"\xe0\x3f", b"\xf8\x7f"))
        bus.publish("robot2/cmd_vel", encode(Twist(0.0, 0.5)))  # after the others, so it tells when to look
        turning = heard(box, lambda samples: any(turn_rate(sample) == 0.5 for sample in samples))
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
    assert odometry_of(turning[-1]) is not None
    assert {one.speed for one in map(odometry_of, turning) if one} == {0.0}
    assert summary["dropped"] == {"robot2/cmd_vel": 2, "overflowed": 0}


def test_a_sensor_sees_the_virtual_leader_of_another_process(tmp_path: Path) -> None:
    text, _ = read("six_robots")
    mission = tmp_path / "local.toml"
    mission.write_text(text.replace("rate = 20 ", 'rate = 20\nmeasurement = "local" '), encoding="utf-8")
    end, lead = free_endpoint(), free_endpoint()
    with (
        leader(lead, "--hold"),
        started("agent.robots", str(mission), "--robot", "robot2", "-l", end, "-e", lead) as robot,
        beside(end, "robot2/relative/robot1", "robot2/odom") as (_, box),
    ):
        robot.event("ready")
        samples = heard(box, lambda samples: sum(map(is_odometry, samples)) >= 12)
    sights = [sample for sample in samples if not is_odometry(sample)]
    seen = decode(Displacement, sights[-1].payload).displacement
    assert seen * 1j + (-1.5 + 2.2j) == pytest.approx(0.0, abs=1e-6)
    # odometry sets the agent off, so it must not overtake what the sensor saw at the same moment
    moments = [stamp(sample) for sample in samples if stamp(sample) >= stamp(sights[0])]
    assert moments == sorted(moments)
    assert all(is_odometry(later) for earlier, later in pairwise(samples) if stamp(earlier) == stamp(later))
    assert len(sights) >= 5


def test_nothing_is_published_before_the_monitor_listens() -> None:
    end = free_endpoint()
    with robot2(end, "--await-monitor", "60") as child:
        with beside(end, "robot2/odom") as (bus, box):
            bus.advertise(CMD_VEL, "robot2/cmd_vel")
            until(lambda: bool(bus.routed("robot2/cmd_vel")))  # so the link is up
            assert not box.wait(1.0), "it spoke before a monitor listened to its ground truth"
            bus.subscribe(GROUND_TRUTH, "robot2/ground_truth")
            first = heard(box, lambda samples: len(samples) >= 8)
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
    assert {sample.key for sample in first} == {"robot2/odom", "robot2/ground_truth"}
    assert summary["robot"]["published"]["robot2/odom"] >= 4


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("module", ["leader", "agent.robots"])
def test_a_polite_signal_ends_it_at_once_with_a_summary_and_exit_code_0(
    module: str, number: signal.Signals
) -> None:
    with started(module, "six_robots", "-l", free_endpoint()) as child:
        child.event("ready")
        took = child.signal(number)
        summary = child.event("summary")
        assert child.wait() == 0
    assert took < 5.0
    assert summary["process"] in {"leader robot1", "robots"}
    assert summary["dropped"] == {"overflowed": 0}
    assert number.name in child.errors


@pytest.mark.parametrize("module", ["leader", "agent.robots"])
@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["no_such_mission"], "no such file, and no shipped mission of that name"),
        (["six_robots", "-l", "tcp/nowhere"], "must be PROTOCOL/HOST:PORT"),
        (["six_robots", "--cfg", "lease"], "must be PATH:VALUE"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(module: str, arguments: list[str], why: str) -> None:
    with started(module, *arguments) as child:
        assert child.wait() == 2
        assert child.errors.count("\n") == 1
        assert why in child.errors


def test_a_robot_that_is_not_in_the_mission_is_refused_by_name() -> None:
    with started("agent.robots", "six_robots", "--robot", "robot9") as child:
        assert child.wait() == 2
        why = "robot 'robot9': must be a follower of six-robots: robot2, robot3, robot4, robot5, robot6"
        assert child.errors == f"robot9: {why}\n"


def test_a_port_that_is_taken_is_named() -> None:
    end = free_endpoint()
    with leader(end), started("leader", "six_robots", "-l", end) as second:
        assert second.wait() == 2
        assert second.errors == (
            f"leader: cannot listen on {end}: the address is in use;"
            " is there a second leader robot1 on this machine?\n"
        )


def test_robots_listen_each_on_an_endpoint_of_its_own_or_all_on_one() -> None:
    ends = free_endpoint(), free_endpoint()
    two = ("--robot", "robot2", "--robot", "robot3")
    for given in (ends, ends[:1]):
        listen = [word for end in given for word in ("-l", end)]
        with started("agent.robots", "six_robots", *two, *listen) as child:
            child.event("ready")
            seen = [inspect(end).subscriptions for end in given]
        assert seen == (
            [{"robot2/cmd_vel"}, {"robot3/cmd_vel"}]
            if len(given) == 2
            else [{"robot2/cmd_vel", "robot3/cmd_vel"}]
        )
    words = [word for end in (*ends, free_endpoint()) for word in ("-l", end)]
    with started("agent.robots", "six_robots", *two, *words) as child:
        assert child.wait() == 2
        why = "-l is given 3 times: must be once for all robots or once for each of robot2, robot3"
        assert child.errors == f"robot2 robot3: {why}\n"


def test_robots_that_ros_cannot_tell_apart_cannot_share_an_endpoint(tmp_path: Path) -> None:
    text, _ = read("six_robots")
    mission = tmp_path / "nameless.toml"
    mission.write_text(text.replace("rate = 20 ", 'rate = 20\nnamespace = "" '), encoding="utf-8")
    two = ("--robot", "robot2", "--robot", "robot3")
    one, other = free_endpoint(), free_endpoint()
    with started("agent.robots", str(mission), *two, "-l", one, "-l", other) as child:
        child.event("ready")
        assert inspect(one).subscriptions == inspect(other).subscriptions == {"cmd_vel"}
    with started("agent.robots", str(mission), *two, "-l", one) as child:
        assert child.wait() == 2
        assert child.errors.count("\n") == 1
        assert one in child.errors
        assert "needs another namespace" in child.errors


@pytest.mark.parametrize("module", ["leader", "agent.robots"])
def test_it_ends_when_its_parent_dies(module: str) -> None:
    parent = (
        "import os, subprocess, sys, time\n"
        f"argv = [sys.executable, '-m', '{module}', 'six_robots', '-l', '{free_endpoint()}']\n"
        "subprocess.Popen([*argv, '--parent', str(os.getpid())], stderr=subprocess.DEVNULL)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as between:
        assert between.stdout is not None
        assert '"ready"' in between.stdout.readline()
        between.kill()
        killed = time.monotonic()
        rest = between.stdout.read()  # ends when nobody holds this pipe any more: the child has ended, too
    assert '"summary"' in rest
    assert time.monotonic() - killed < 5.0


def is_odometry(sample: Sample) -> bool:
    return sample.key == "robot2/odom"


def odometry(samples: Sequence[Sample]) -> bool:
    return any(map(is_odometry, samples))


def odometry_of(sample: Sample) -> Odometry | None:
    return decode(Odometry, sample.payload) if is_odometry(sample) else None


def stamp(sample: Sample) -> float:
    said = odometry_of(sample) or decode(Displacement, sample.payload)
    return said.stamp


def turn_rate(sample: Sample) -> float:
    return decode(Odometry, sample.payload).turn_rate


def newest_odometry(samples: Sequence[Sample]) -> Odometry | None:
    """The last odometry among samples of all kinds."""
    return next(filter(None, map(odometry_of, reversed(samples))), None)


def is_at(samples: Sequence[Sample], speed: float) -> bool:
    """Whether the newest odometry says so."""
    newest = newest_odometry(samples)
    return newest is not None and newest.speed == speed
