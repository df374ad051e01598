"""Section 5 of the paper with two played TurtleBots, real agents and leader, by each ROS 2 transport.

Each test stays below 2 cm with truncated commands, and has another transport or another type of command.
"""

from __future__ import annotations

import bisect
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from formation.mission.file import parse, read
from formation.mission.model import Mission
from formation.ros2 import tokens
from formation.ros2.messages import Diagnostics, Pose, decode
from formation.ros2.naming import Naming
from formation.topics import POSITION, STATUS, Topic
from formation.transport.bus import Bus, BusConfig
from tests.processes.agent.turtlebot3 import TurtleBot3, Wire
from tests.support.child import PATIENCE, Child, held_endpoint, started, until
from tests.support.missions import edited
from tests.unit.formation.by_rosbags import STORE

pytestmark = pytest.mark.processes
GOOD = 0.02
"""Formation error of the true poses, summed over the edges [m]."""
LONG_ENOUGH = 5.0
"""Time for which the error must stay below `GOOD` [s]."""
PAIR = read("turtlebot3_pair")[0]
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
FIRMWARE = 'odometry_frame = "start"\nspeed_step = 0.01\nturn_rate_step = 0.01'


class Team:
    """Two played robots, their agents, and a bus that receives the leader's position."""

    def __init__(self, mission: Mission, robots: dict[str, TurtleBot3], watcher: Bus) -> None:
        self.mission, self.robots, self._watcher = mission, robots, watcher
        self.agents: dict[str, Child] = {}
        self.errors: list[tuple[float, float]] = []
        """Wall clock [s] and formation error [m], for each position of the leader."""

    def watch(self) -> None:
        """Compute the true formation error at each position that the leader has sent."""
        self._watcher.wait(0.1)
        for sample in self._watcher.drain():
            if sample.key == POSITION.key(self.mission.leader):
                leader = decode(Pose, sample.payload)
                error = sum(
                    abs(self.control_point(name, leader.stamp) - leader.position - self.mission.slot(name))
                    for name in self.robots
                )
                self.errors.append((leader.stamp, error))

    def control_point(self, name: str, wall: float) -> complex:
        """Return the true control point of a robot at a time [m; world frame]."""
        path = self.robots[name].path
        at = min(max(bisect.bisect(path, wall, key=lambda one: one.wall), 1), len(path) - 1)
        before, after = path[at - 1], path[at]
        share = (wall - before.wall) / (after.wall - before.wall)
        offset = self.mission.robots[name].control_point_offset
        points = [one.position + offset * one.heading for one in (before, after)]
        return points[0] + share * (points[1] - points[0])

    def settles(self) -> None:
        """Wait until the error has been below `GOOD` for `LONG_ENOUGH`."""
        deadline = time.monotonic() + PATIENCE + LONG_ENOUGH
        good_since = len(self.errors)
        while len(self.errors) <= good_since or self.errors[-1][0] - self.errors[good_since][0] < LONG_ENOUGH:
            assert time.monotonic() < deadline, self._account()
            seen = len(self.errors)
            self.watch()
            for number in range(seen, len(self.errors)):
                if self.errors[number][1] >= GOOD:
                    good_since = number + 1

    def _account(self) -> str:
        """Describe why the error may be large: errors over time, each robot, its agent's status and log."""
        lines = [f"errors: {[(round(at, 2), round(error, 4)) for at, error in self.errors[::20]]}"]
        for name, robot in self.robots.items():
            topic = Listener(self, name, STATUS)
            (result,) = decode(Diagnostics, bytes(topic.next().payload)).statuses
            at = self.control_point(name, self.errors[-1][0])
            lines += [f"{name} at {at:.3f}, moves {robot.moving}, lost {robot.lost}: {result}"]
            lines += [f"log of {name}: {self.agents[name].log}"]
            lines += [
                f"commands of {name}: {[(round(one.mono, 2), *one.commanded) for one in robot.taken[::4]]}"
            ]
        return "\n".join(lines)


class Listener:
    """Receives one topic of a robot's agent, as other ROS 2 nodes on the robot do."""

    def __init__(self, team: Team, robot: str, topic: Topic) -> None:
        played, naming = team.robots[robot], Naming.of(team.mission.robots, [robot])
        self._samples = played.session.declare_subscriber(
            naming.wire(topic.key(robot)), zenoh.handlers.RingChannel(20)
        )

    def next(self) -> zenoh.Sample:
        samples: list[zenoh.Sample] = []
        until(lambda: self._receive(samples))
        return samples[0]

    def value(self, name: str, fits: Callable[[str], bool]) -> str:
        """Wait until the value `name` of the status `fits`; return it."""
        deadline = time.monotonic() + PATIENCE
        while True:
            (result,) = decode(Diagnostics, bytes(self.next().payload)).statuses
            if fits(result.values.get(name, "")):
                return result.values[name]
            assert time.monotonic() < deadline, f"status has {result.values}"

    def _receive(self, samples: list[zenoh.Sample]) -> bool:
        sample = self._samples.try_recv()
        if sample is not None:
            samples.append(sample)
        return sample is not None


@contextmanager
def running(
    tmp_path: Path, ros: str, kind: str, *, prefixed: bool = False, domain: int = 0, bare: bool = False
) -> Iterator[Team]:
    """Run the mission; ``bare`` robots have no namespace, as delivered."""
    keys = f'ros = "{ros}"\ncmd_vel = "{kind}"\ndomain = {domain}\n{FIRMWARE}'
    text = edited(PAIR, "robot", f'{keys}\nnamespace = ""' if bare else keys)
    file = tmp_path / "pair.toml"
    with ExitStack() as stack:
        for name in ("leader", "robot1", "robot2"):
            ends = f'endpoint = "{stack.enter_context(held_endpoint())}"\n'
            if name != "leader":
                ends += f'robot_endpoint = "{stack.enter_context(held_endpoint())}"\n'
            text = edited(text, f"robots.{name}", ends)
        mission = parse(text)
        file.write_text(text, encoding="utf-8")
        robots = {}
        for name in mission.followers:
            spec = mission.robots[name]
            assert spec.robot_endpoint is not None
            wire = Wire(ros, kind, domain, "" if bare else name)
            robot = TurtleBot3(
                wire, spec.robot_endpoint, spec.start.position, spec.start.heading, prefixed=prefixed
            )
            robots[name] = stack.enter_context(robot)
        leads = mission.robots[mission.leader].endpoint
        assert leads is not None
        watcher = stack.enter_context(Bus(BusConfig(connect=(leads,))))
        watcher.subscribe(POSITION.key(mission.leader))
        team = Team(mission, robots, watcher)
        for name in robots:
            team.agents[name] = stack.enter_context(started("formation.agent", str(file), "--robot", name))
        leader = stack.enter_context(started("formation.leader", str(file)))
        for child in (*team.agents.values(), leader):
            child.event("ready")
        yield team


def assert_all_commands_were_valid(team: Team) -> None:
    for robot in team.robots.values():
        assert robot.troubles == {}
        assert robot.lost == 0
        assert len(robot.taken) > 100
        # the agent has truncated its commands itself, so that it knows the remainder
        assert (
            max(abs(t - o) for one in robot.taken for t, o in zip(one.commanded, one.obeyed, strict=True))
            < 1e-9
        )
        assert all(round(one.obeyed.speed * 100, 9) % 1.0 == 0.0 for one in robot.taken)


def test_odometry_reset_during_mission_causes_no_lurch(tmp_path: Path) -> None:
    with running(tmp_path, "rmw_zenoh", "twist", prefixed=True) as team:
        team.settles()
        robot, received = team.robots["robot2"], Listener(team, "robot2", STATUS)
        # at a time at which at most one earlier command may be on its way
        until(lambda: robot.taken[-1].mono > robot.path[-1].wall - time.time() + time.monotonic())
        begun = time.time()
        before, reset = robot.reset_odometry(), time.time()
        while team.errors[-1][0] < reset + 2.0:
            team.watch()
        after = robot.taken[before:]
        usual = robot.taken[before - 60 : before]
        lost = max(error for wall, error in team.errors if wall > begun)
        assert lost < GOOD
        offset = team.mission.robots["robot2"].control_point_offset
        for part, metres in (("speed", 1.0), ("turn_rate", offset)):
            most = max(abs(getattr(one.commanded, part)) for one in usual)
            # the law closes at its gain what the robot lost while it stood, which depends on the time
            closing = team.mission.gains.k_p * lost / metres
            assert max(abs(getattr(one.commanded, part)) for one in after) < most + 0.1 + closing
        # it stands until its odometry is aligned again
        assert (0.0, 0.0) in [one.commanded for one in after[:2]]
        assert received.value("realigned", lambda count: count != "0") == "1"
        assert received.value("realigned_after", bool).endswith("_jumped")
        assert_all_commands_were_valid(team)


def test_ros_2_nodes_see_agent_and_its_topics(tmp_path: Path) -> None:
    with running(tmp_path, "rmw_zenoh", "twist_stamped", domain=30) as team:
        robot = team.robots["robot1"]
        position, status = Listener(team, "robot1", POSITION), Listener(team, "robot1", STATUS)
        sample = position.next()
        assert str(sample.key_expr) == robot.wire.key("position", POSE_TYPE)
        assert sample.attachment is not None
        assert len(bytes(sample.attachment)) == 33
        pose: Any = STORE.deserialize_cdr(bytes(sample.payload), POSE_TYPE)
        stamp = pose.header.stamp.sec + 1e-9 * pose.header.stamp.nanosec
        then = min(robot.path, key=lambda one: abs(one.wall - stamp))
        assert abs(complex(pose.pose.position.x, pose.pose.position.y) - then.position) < 0.05
        status.value("link", lambda link: link == "connected")
        seen = [token for key in robot.graph() if (token := tokens.read(key)) is not None]
        agent = [one for one in seen if one.node == "_formation_agent"]
        assert len({one.zid for one in agent}) == 1
        assert len({one.id for one in agent}) == len(agent)
        assert {one.namespace for one in agent} == {"robot1"}
        shown = {(one.kind, one.topic, one.type) for one in agent}
        assert shown >= {
            ("NN", "", ""),
            ("MP", "robot1/cmd_vel", "geometry_msgs/msg/TwistStamped"),
            ("MP", "robot1/position", POSE_TYPE),
            ("MP", "robot1/status", "diagnostic_msgs/msg/DiagnosticArray"),
            ("MS", "robot1/odom", "nav_msgs/msg/Odometry"),
        }
        own = {token for token in robot.graph() if "turtlebot3_node" in token}
        assert own == set(robot.wire.tokens(str(robot.session.info.zid())))
        team.settles()
        assert_all_commands_were_valid(team)
        child = team.agents["robot1"]
        child.signal(signal.SIGTERM)
        until(lambda: len(robot.graph()) == len(own))


def test_bridge_positions_are_plain_and_lost_route_reported(tmp_path: Path) -> None:
    with running(tmp_path, "ros2dds", "twist", bare=True) as team:
        position, status = Listener(team, "robot1", POSITION), Listener(team, "robot1", STATUS)
        sample = position.next()
        assert str(sample.key_expr) == "position"
        assert sample.attachment is None  # the order is sent to the fleet only
        STORE.deserialize_cdr(bytes(sample.payload), POSE_TYPE)
        status.value("link", lambda link: link == "connected")
        team.settles()
        assert_all_commands_were_valid(team)
        team.robots["robot1"].lose_route()
        assert status.value("link", lambda link: link != "connected") == "no_listener"
