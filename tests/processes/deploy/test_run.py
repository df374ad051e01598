"""`formation run` with all its real processes, real Zenoh and a real recording."""

from __future__ import annotations

import cmath
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median

import psutil
import pytest
from mcap.reader import make_reader

from formation.mission.file import load, read
from formation.mission.model import Mission
from formation.monitor.recording import reader
from formation.monitor.recording.channels import SUFFIX
from formation.ros2.messages import Diagnostics, Odometry, Pose, TwistStamped, decode
from formation.topics import (
    CMD_VEL,
    DIAGNOSTICS,
    ERROR,
    EVENTS,
    GROUND_TRUTH,
    ODOM,
    POSITION,
    STATUS,
    command_topic,
)
from tests.support.child import until
from tests.support.launched import (
    Output,
    assert_commands_reproduced,
    formed,
    result_of,
    started,
    wait_until_formed,
    wait_until_running,
)

pytestmark = pytest.mark.processes
AT_REST = 1e-3
"""[m/s] and [rad/s]"""
LONGEST_REDIAL = 1.0
"""Zenoh's longest pause between two attempts [s]."""


def topics_of(mission: Mission) -> dict[str, str]:
    """ROS 2 type of every topic that a run of `mission` must have, by the name that ROS 2 gives it."""
    keys = {one.key(): one for one in (ERROR, DIAGNOSTICS, EVENTS)}
    for name in mission.names:
        keys |= {topic.key(name): topic for topic in (POSITION, STATUS)}
    for name in mission.followers:
        keys |= {topic.key(name): topic for topic in (ODOM, GROUND_TRUTH)}
        keys[CMD_VEL.key(name)] = command_topic(mission.robots[name].cmd_vel)
    return {f"/{key}": topic.type for key, topic in keys.items()}


def payloads_of(recording: Path) -> dict[str, list[bytes]]:
    """All messages of each topic."""
    found: dict[str, list[bytes]] = {}
    with recording.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append(message.data)
    return found


def driven(recording: Path, robot: str) -> float:
    """How far a robot has come from its start, by what has been recorded so far [m]."""
    messages = (one.sample for one in reader.read(recording).messages())
    truths = [decode(Pose, one.payload) for one in messages if one.key == GROUND_TRUTH.key(robot)]
    return abs(truths[-1].position - truths[0].position) if truths else 0.0


def at_rest(poses: Sequence[Pose]) -> bool:
    """Whether a robot stands still from the first to the last of its poses."""
    return all(
        abs(after.position - before.position) < AT_REST * (after.stamp - before.stamp)
        and abs(cmath.phase(after.heading / before.heading)) < AT_REST * (after.stamp - before.stamp)
        for before, after in pairwise(poses)
    )


def test_shipped_mission_converges_with_complete_recording(tmp_path: Path) -> None:
    name, mission = "six_robots", load("six_robots")
    recording = tmp_path / "run.mcap"
    with started(name, "--duration", "90", "--record", recording.name, folder=tmp_path) as process:
        result = formed(process, 0.01, within=12.0)
    assert process.returncode == 0
    assert result["converged"]
    assert result["formation_error"] < 0.01
    assert 0.0 < result["settling_time"] < result["duration"]

    processes = result["processes"]
    assert list(processes) == [
        "monitor", "robots", "leader", *(f"agent {robot}" for robot in mission.followers),
    ]  # fmt: skip
    assert all(one["exit"] == 0 and not one["died"] for one in processes.values())
    pids = {one["pid"] for one in processes.values()}
    assert len(pids | {process.pid}) == len(processes) + 1
    assert not any(psutil.pid_exists(pid) for pid in pids)

    assert result["lost"] == 0
    to_the_fleet = sum(one["published"] for one in processes.values())
    truths = processes["monitor"]["robot"]["received"]
    assert processes["robots"]["published"] == 0
    assert processes["robots"]["robot"]["published"] == 2 * truths  # ground truth, and as much odometry
    assert result["recorded"] == to_the_fleet + truths
    with recording.open("rb") as file:
        types, counts = {}, Counter[str]()
        for schema, channel, _ in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            if channel.topic.endswith(SUFFIX):  # attachments; their messages are counted
                continue
            types[channel.topic] = schema.name
            counts[channel.topic] += 1
    assert types == topics_of(mission)
    assert counts.total() == result["recorded"]
    said_by = payloads_of(recording)
    for robot in mission.followers:
        driven = [decode(Odometry, payload).stamp for payload in said_by[f"/{ODOM.key(robot)}"]]
        truths = [decode(Pose, payload).stamp for payload in said_by[f"/{GROUND_TRUTH.key(robot)}"]]
        # the agent republishes odometry; recorded once the monitor is connected to all robots
        assert driven[-1] - driven[0] > 0.95 * result["duration"] - LONGEST_REDIAL
        meanwhile = [stamp for stamp in truths if driven[0] <= stamp <= driven[-1]]
        assert 0.95 * len(meanwhile) < len(driven) <= len(truths)
        # a busy robot skips a message, and publishes the next in time
        assert median(after - before for before, after in pairwise(meanwhile)) == pytest.approx(0.05, rel=0.1)
        assert len(driven) <= counts[f"/{CMD_VEL.key(robot)}"]
    assert_commands_reproduced(recording)


@pytest.mark.smoke
def test_ctrl_c_brings_robots_to_rest_and_ends_processes(tmp_path: Path) -> None:
    mission = load("turtlebot3_pair")
    flags = ("--law", "paper", "--record", "run.mcap")
    with started("turtlebot3_pair", *flags, folder=tmp_path) as process:
        children = wait_until_running(process, 1.5)  # no robot has reached its slot yet
        assert len(children) == len(mission.followers) + 3
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does on Ctrl-C
        result = result_of(process)
    assert process.returncode in {0, 1}
    assert process.returncode == (0 if result["converged"] else 1)
    assert result["interrupted"]
    assert result["duration"] < 20.0
    assert all(one["exit"] == 0 for one in result["processes"].values())
    assert not any(child.is_running() for child in children)
    assert result["lost"] == 0
    said_by = payloads_of(tmp_path / "run.mcap")
    for robot in mission.followers:
        # by ground truth: the agents, which republish odometry, have ended
        assert at_rest([decode(Pose, payload) for payload in said_by[f"/{GROUND_TRUTH.key(robot)}"][-2:]])
        command = decode(TwistStamped, said_by[f"/{CMD_VEL.key(robot)}"][-1])
        assert (command.speed, command.turn_rate) == (0.0, 0.0)
        output = decode(Diagnostics, said_by[f"/{STATUS.key(robot)}"][-1]).statuses[0]
        assert output.values["law"] == result["law"] == "paper"


def test_killed_launcher_leaves_no_process(tmp_path: Path) -> None:
    with started("turtlebot3_pair", "--record", "run.mcap", folder=tmp_path) as process:
        children = wait_until_running(process, 1.0)
        process.kill()
        process.wait()
        begin = time.monotonic()
        _, alive = psutil.wait_procs(children, timeout=10.0)
    assert alive == []
    assert time.monotonic() - begin < 6.0


def test_watchdog_stops_robot_of_killed_agent_in_run(tmp_path: Path) -> None:
    flags = ("--watchdogs", "--duration", "300", "--record", "run.mcap")
    with started("turtlebot3_pair", *flags, folder=tmp_path) as process:
        reported = Output(process)
        children = reported.wait(1.0)
        until(lambda: driven(tmp_path / "run.mcap", "robot2") > 0.05)
        victim = next(one for one in children if {"formation.agent", "robot2"} <= set(one.cmdline()))
        victim.kill()
        reported.wait_more(4.0)
        process.send_signal(signal.SIGINT)
        reported.ended()
        result = result_of(process)
    processes = result["processes"]
    assert {name: one["exit"] for name, one in processes.items() if one["exit"]} == {
        "agent robot2": -signal.SIGKILL
    }
    assert (
        processes["watchdog robot2"]["robot"]["published"]
        > processes["watchdog robot1"]["robot"]["published"]
    )
    truth = payloads_of(tmp_path / "run.mcap")[f"/{GROUND_TRUTH.key('robot2')}"]
    poses = [decode(Pose, payload) for payload in truth]
    assert at_rest(poses[-60:])
    assert abs(poses[-1].position - poses[0].position) > 0.05  # the robot had been driving


def test_field_mission_runs_on_local_ports(tmp_path: Path) -> None:
    text, _ = read("turtlebot3_pair")
    text = text.replace("[robot]", '[robot]\nrobot_endpoint = "tcp/127.0.0.1:7447"\nros = "rmw_zenoh"')
    for number, name in enumerate(("leader", "robot1", "robot2")):
        end = f'endpoint = "tls/192.168.50.{10 + number}:7460"\nnamespace = ""'
        text = text.replace(f"[robots.{name}]", f"[robots.{name}]\n{end}")
    (tmp_path / "field.toml").write_text(text)
    flags = ("--watchdogs", "--duration", "90", "--record", "run.mcap")
    with started("field.toml", *flags, folder=tmp_path) as process:
        assert process.stderr is not None
        hint = process.stderr.readline().partition("another terminal: ")[2].split()
        links = hint[3:]
        wait_until_running(process, 2.0)
        command = [
            sys.executable,
            "-m",
            "formation.deploy",
            "order",
            "field.toml",
            "release",
            "--json",
            *links,
        ]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=60.0, check=False, cwd=tmp_path
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert wait_until_formed(process, load("turtlebot3_pair").settled) <= 12.0
        os.kill(process.pid, signal.SIGTERM)
        result = result_of(process)
    assert links[::2] == ["-e"] * 3
    assert all(end.startswith("tcp/127.0.0.1:") for end in links[1::2])
    assert process.returncode == 0
    assert (result["converged"], result["lost"]) == (True, 0)


@pytest.mark.smoke
def test_bad_mission_exits_with_2_and_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text('name = "bad"\nleader = "nobody"\n')
    with started("bad.toml", folder=tmp_path) as process:
        out, err = process.communicate(timeout=30.0)
    assert (process.returncode, out) == (2, "")
    assert err.count("\n") == 1
    assert "bad.toml" in err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]
