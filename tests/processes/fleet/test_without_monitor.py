"""Nobody needs the monitor: it is killed, and nothing changes for the robots."""

from __future__ import annotations

import signal
import time
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest

from formation.mission.file import load
from formation.ros2.messages import Pose, Twist, decode
from formation.topics import CMD_VEL, GROUND_TRUTH, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.wire import Sample
from tests.processes.fleet.test_decentralised import running
from tests.support.child import PATIENCE

pytestmark = pytest.mark.processes
SIX = load("six_robots")


class Witness:
    """A stranger who only looks on: true poses of the robots, and every command that one gets."""

    def __init__(self, box: Mailbox) -> None:
        self.box, self.commands, self.poses = box, dict[str, list[Twist]](), dict[str, Pose]()
        self.periods, self.longest = Counter[str](), Counter[str]()
        """Of each robot, since its newest command and at most: it tells where it is once in each."""

    def watch(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.box.wait(left)
            for sample in self.box.drain():
                self._see(sample)

    def _see(self, sample: Sample) -> None:
        robot, _, topic = sample.key.partition("/")
        if topic == CMD_VEL.name:
            self.commands.setdefault(robot, []).append(decode(Twist, sample.payload))
            self.periods[robot] = 0
        else:
            self.poses[sample.key] = decode(Pose, sample.payload)
            self.periods[robot] += 1
            self.longest[robot] = max(self.longest[robot], self.periods[robot])

    def error(self) -> float:
        """Formation error of the true control points, brought to one moment at the leader's velocity [m]."""
        lead = self.poses[POSITION.key(SIX.leader)]
        velocity = SIX.leader_heading * SIX.route[0].speed
        points = {SIX.leader: lead.position}
        for robot in SIX.followers:
            pose = self.poses[GROUND_TRUTH.key(robot)]
            offset = SIX.robots[robot].control_point_offset
            points[robot] = pose.position + offset * pose.heading + velocity * (lead.stamp - pose.stamp)
        return sum(
            abs(points[j] - points[i] - SIX.slot(j) + SIX.slot(i))
            for i in SIX.followers
            for j in SIX.robots[i].neighbours
        )

    def formed(self) -> bool:
        """Whether all stand where they should, and each is told to drive."""
        return self.error() < 0.01 and all(self.commands[robot][-1].speed != 0.0 for robot in SIX.followers)


def test_killing_the_monitor_changes_nothing(tmp_path: Path) -> None:
    box = Mailbox()
    with (
        running("six_robots", tmp_path / "run.mcap") as team,
        Bus(BusConfig(connect=(team.where.agents[SIX.leader],)), box) as bus,
        closing(RobotBuses(SIX, team.where.robots, box, node="witness")) as robots,
    ):
        bus.subscribe(POSITION.key(SIX.leader))
        for robot in SIX.followers:
            robots.subscribe(CMD_VEL, CMD_VEL.key(robot))
            robots.subscribe(GROUND_TRUTH, GROUND_TRUTH.key(robot))
        witness = Witness(box)
        witness.watch(4.0)
        witness.longest.clear()
        witness.commands.clear()
        team.children["monitor"].signal(signal.SIGKILL)
        witness.watch(8.0)
        for reported in witness.commands.values():
            driving = sum(one.speed != 0.0 for one in reported)
            assert driving > 0.8 * len(
                reported
            )  # who stands once has heard nothing, for the machine stood still
        deadline = time.monotonic() + PATIENCE
        while not witness.formed():  # who heard nothing while the machine stood still has held since, or lags
            assert time.monotonic() < deadline, witness.error()
            witness.watch(0.1)
        for robot in SIX.followers:
            # half a second of the robot's own: those stand still when the machine does
            assert 0 < witness.longest[robot] < 0.5 * SIX.robots[robot].rate
        survivors = [name for name, child in team.children.items() if child.process.poll() is None]
        assert set(survivors) == set(team.children) - {"monitor"}
