"""Simulated robots as real processes, each of which is its own ROS 2 router."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from itertools import dropwhile, pairwise
from pathlib import Path

import pytest

from formation.agent.simulated.__main__ import main
from formation.mission.file import read
from formation.ros2.messages import Displacement, Odometry, Twist, decode, encode
from formation.topics import CMD_VEL, GROUND_TRUTH
from formation.wire import Sample
from tests.processes.agent.leader_and_robot import SIX, agent_side, leader, listening, received, robot2
from tests.support.child import free_endpoint, started, until
from tests.support.zenoh_admin import inspect
from tests.unit.leader.leading import relayed

pytestmark = pytest.mark.processes
TWO = ("--robot", "robot2", "--robot", "robot3")


def test_simulated_robot_moves_and_stops_as_commanded() -> None:
    end = free_endpoint()
    with robot2(end) as child, agent_side(end, "robot2/odom", "robot2/ground_truth") as (bus, box):
        bus.advertise(CMD_VEL, "robot2/cmd_vel")
        at_rest = newest_odometry(received(box, has_odometry))
        assert at_rest is not None
        assert at_rest.position == -1.5 + 2.0j
        bus.publish("robot2/cmd_vel", encode(Twist(0.5, 0.0)))
        moving = received(box, lambda samples: newest_speed_is(samples, 0.5) and len(samples) >= 40)
        bus.publish("robot2/cmd_vel", encode(Twist(0.0, 0.0)))
        stopped = newest_odometry(received(box, lambda samples: newest_speed_is(samples, 0.0)))
        for invalid in (
            b"\x00\x01\x00\x00 and too short",
            encode(Twist(0.5, 0.0)).replace(b"\xe0\x3f", b"\xf8\x7f"),  # not a number
        ):
            bus.publish("robot2/cmd_vel", invalid)
        bus.publish("robot2/cmd_vel", encode(Twist(0.0, 0.5)))  # sent last: then all have arrived
        turning = received(box, lambda samples: any(turn_rate(sample) == 0.5 for sample in samples))
        assert child.signal(signal.SIGTERM) < 5.0
        assert child.wait() == 0
        summary = child.event("summary")
    assert "SIGTERM" in child.errors
    fast = [one for one in map(odometry_of, moving) if one is not None and one.speed == 0.5]
    seconds, way = fast[-1].stamp - fast[0].stamp, fast[-1].position - fast[0].position
    assert way == pytest.approx(0.5j * seconds, abs=1e-4)
    assert stopped is not None
    assert stopped.position.imag > fast[-1].position.imag
    assert {one.speed for one in map(odometry_of, turning) if one} == {0.0}
    assert summary["robot"]["received"] == {"robot2/cmd_vel": 5}
    assert summary["dropped"] == {"robot2/cmd_vel": 2, "overflowed": 0}
    result = summary["robot"]["published"]
    assert result["robot2/odom"] == result["robot2/ground_truth"]
    assert (summary["process"], summary["published"], summary["received"]) == ("robot robot2", {}, {})


def test_simulated_sensor_measures_leader_of_another_process(tmp_path: Path) -> None:
    text, _ = read("six_robots")
    mission = tmp_path / "local.toml"
    mission.write_text(text.replace("rate = 20 ", 'rate = 20\nmeasurement = "local" '), encoding="utf-8")
    end, lead = free_endpoint(), free_endpoint()
    with (
        leader(lead, "--hold"),
        listening(lead) as agents,
        started(
            "formation.agent.simulated", str(mission), "--robot", "robot2", "-l", end, "-e", lead
        ) as robot,
        agent_side(end, "robot2/relative/robot1", "robot2/odom") as (_, box),
    ):
        robot.event("ready")

        def enough(samples: Sequence[Sample]) -> bool:
            # the robot may link with the leader later than the test with the robot
            agents.send([relayed("robot2", None, of=SIX)])  # the leader first receives a robot
            return sum(map(is_odometry, since_first_measurement(samples))) >= 12

        samples = received(box, enough)
    measurements = [sample for sample in samples if not is_odometry(sample)]
    seen = decode(Displacement, measurements[-1].payload).displacement
    assert seen * 1j + (-1.5 + 2.2j) == pytest.approx(0.0, abs=1e-6)
    # odometry triggers the agent's step, so it must arrive after measurements of the same time
    moments = [stamp(sample) for sample in samples if stamp(sample) >= stamp(measurements[0])]
    assert moments == sorted(moments)
    assert all(is_odometry(later) for earlier, later in pairwise(samples) if stamp(earlier) == stamp(later))
    assert len(measurements) >= 5


def test_await_monitor_delays_publishing_until_monitor_subscribes() -> None:
    end = free_endpoint()
    with robot2(end, "--await-monitor", "60") as child:
        with agent_side(end, "robot2/odom") as (bus, box):
            bus.advertise(CMD_VEL, "robot2/cmd_vel")
            until(lambda: bool(bus.routed("robot2/cmd_vel")))  # so the link is up
            assert not box.wait(1.0), "published before a monitor listened to its ground truth"
            bus.subscribe(GROUND_TRUTH, "robot2/ground_truth")
            first = received(box, lambda samples: len(samples) >= 8)
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
    assert {sample.key for sample in first} == {"robot2/odom", "robot2/ground_truth"}
    assert summary["robot"]["published"]["robot2/odom"] >= 4


def test_robots_listen_on_one_endpoint_each_or_shared() -> None:
    ends = free_endpoint(), free_endpoint()
    for given in (ends, ends[:1]):
        listen = [word for end in given for word in ("-l", end)]
        with started("formation.agent.simulated", "six_robots", *TWO, *listen) as child:
            child.event("ready")
            seen = [inspect(end).subscriptions for end in given]
        assert seen == (
            [{"robot2/cmd_vel"}, {"robot3/cmd_vel"}]
            if len(given) == 2
            else [{"robot2/cmd_vel", "robot3/cmd_vel"}]
        )


def test_robots_without_namespace_cannot_share_an_endpoint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, _ = read("six_robots")
    mission = tmp_path / "nameless.toml"
    mission.write_text(text.replace("rate = 20 ", 'rate = 20\nnamespace = "" '), encoding="utf-8")
    one, other = free_endpoint(), free_endpoint()
    with started("formation.agent.simulated", str(mission), *TWO, "-l", one, "-l", other) as child:
        child.event("ready")
        assert inspect(one).subscriptions == inspect(other).subscriptions == {"cmd_vel"}
    refusal = refused(capsys, str(mission), *TWO, "-l", one)
    assert one in refusal
    assert "needs another namespace" in refusal


def test_unknown_robot_and_wrong_number_of_endpoints_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    why = "robot 'robot9': must be a follower of six-robots: robot2, robot3, robot4, robot5, robot6"
    assert refused(capsys, "six_robots", "--robot", "robot9") == f"robot9: {why}\n"
    words = [word for end in ("tcp/a:1", "tcp/a:2", "tcp/a:3") for word in ("-l", end)]
    why = "-l is given 3 times: must be once for all robots or once for each of robot2, robot3"
    assert refused(capsys, "six_robots", *TWO, *words) == f"robot2 robot3: {why}\n"


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the only line that is printed when simulated robots refuse their arguments."""
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    return printed.err


def is_odometry(sample: Sample) -> bool:
    return sample.key == "robot2/odom"


def since_first_measurement(samples: Sequence[Sample]) -> list[Sample]:
    """Return the samples since the first measurement."""
    return list(dropwhile(is_odometry, samples))


def has_odometry(samples: Sequence[Sample]) -> bool:
    return any(map(is_odometry, samples))


def odometry_of(sample: Sample) -> Odometry | None:
    return decode(Odometry, sample.payload) if is_odometry(sample) else None


def stamp(sample: Sample) -> float:
    result = odometry_of(sample) or decode(Displacement, sample.payload)
    return result.stamp


def turn_rate(sample: Sample) -> float | None:
    odometry = odometry_of(sample)
    return None if odometry is None else odometry.turn_rate


def newest_odometry(samples: Sequence[Sample]) -> Odometry | None:
    """Return the last odometry among samples of all kinds."""
    return next(filter(None, map(odometry_of, reversed(samples))), None)


def newest_speed_is(samples: Sequence[Sample], speed: float) -> bool:
    """Whether the newest odometry has this speed."""
    newest = newest_odometry(samples)
    return newest is not None and newest.speed == speed
