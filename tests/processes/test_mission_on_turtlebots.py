"""Section 5 of the paper on two TurtleBots, by real agents and a real leader, however ROS 2 reaches Zenoh."""

from __future__ import annotations

import bisect
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from formation.bus import Bus, BusConfig
from formation.messages import Pose, decode
from formation.mission import Mission
from formation.mission_file import parse, read
from formation.topics import POSITION
from tests.formation.edited import edited
from tests.processes.child import PATIENCE, Child, free_endpoint, started
from tests.processes.turtlebot3 import TurtleBot3, Wire

pytestmark = pytest.mark.processes
VARIANTS = [(ros, kind) for ros in ("ros2dds", "rmw_zenoh") for kind in ("twist", "twist_stamped")]
GOOD = 0.02
"""Formation error of the true poses, summed over the edges [m]."""
LONG_ENOUGH = 5.0
"""It must stay that good for so long [s]."""
PAIR = read("turtlebot3_pair")[0]
FIRMWARE = 'odometry_frame = "start"\nspeed_step = 0.01\nturn_rate_step = 0.01'


class Team:
    """Two played robots, their agents and the leader, and who watches."""

    def __init__(self, mission: Mission, robots: dict[str, TurtleBot3], watcher: Bus) -> None:
        self.mission, self.robots, self._watcher = mission, robots, watcher
        self.agents: dict[str, Child] = {}
        self.errors: list[tuple[float, float]] = []
        """Wall clock [s] and formation error [m], for each position of the leader."""

    def watch(self) -> None:
        """Compare all that the leader has said with where the robots then were."""
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
        """Where the control point of a robot truly was [m; world frame]."""
        path = self.robots[name].path
        at = min(max(bisect.bisect(path, wall, key=lambda one: one.wall), 1), len(path) - 1)
        before, after = path[at - 1], path[at]
        share = (wall - before.wall) / (after.wall - before.wall)
        offset = self.mission.robots[name].control_point_offset
        points = [one.position + offset * one.heading for one in (before, after)]
        return points[0] + share * (points[1] - points[0])

    def settles(self) -> list[float]:
        """Wait until the error has been good for long enough; those errors."""
        deadline = time.monotonic() + PATIENCE + LONG_ENOUGH
        good_since = len(self.errors)
        while len(self.errors) <= good_since or self.errors[-1][0] - self.errors[good_since][0] < LONG_ENOUGH:
            assert time.monotonic() < deadline, f"the last errors are {self.errors[-20:]}"
            seen = len(self.errors)
            self.watch()
            for number in range(seen, len(self.errors)):
                if self.errors[number][1] >= GOOD:
                    good_since = number + 1
        return [error for _, error in self.errors[good_since:]]


@contextmanager
def running(tmp_path: Path, ros: str, kind: str, *, prefixed: bool = False) -> Iterator[Team]:
    text = edited(PAIR, "robot", f'ros = "{ros}"\ncmd_vel = "{kind}"\n{FIRMWARE}')
    for name in ("leader", "robot1", "robot2"):
        ends = f'endpoint = "{free_endpoint()}"\n'
        if name != "leader":
            ends += f'robot_endpoint = "{free_endpoint()}"\n'
        text = edited(text, f"robots.{name}", ends)
    mission = parse(text)
    file = tmp_path / "pair.toml"
    file.write_text(text, encoding="utf-8")
    with ExitStack() as stack:
        robots = {}
        for name in mission.followers:
            spec = mission.robots[name]
            assert spec.robot_endpoint is not None
            wire = Wire(ros, kind, namespace=name)
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
            team.agents[name] = stack.enter_context(started("agent", str(file), "--robot", name))
        leader = stack.enter_context(started("leader", str(file)))
        for child in (*team.agents.values(), leader):
            child.event("ready")
        yield team


def assert_nothing_wrong_was_sent(team: Team) -> None:
    for robot in team.robots.values():
        assert robot.troubles == {}
        assert robot.lost == 0
        assert len(robot.taken) > 100
        # the agent has cut its commands itself, so that it knows what is left over
        assert (
            max(abs(t - o) for one in robot.taken for t, o in zip(one.told, one.obeyed, strict=True)) < 1e-9
        )
        assert all(round(one.obeyed.speed * 100, 9) % 1.0 == 0.0 for one in robot.taken)


@pytest.mark.parametrize(("ros", "kind"), VARIANTS)
def test_the_formation_stands_within_2_cm_though_commands_are_cut(
    ros: str, kind: str, tmp_path: Path
) -> None:
    with running(tmp_path, ros, kind) as team:
        began = time.time()
        errors = team.settles()
        print(
            f"{ros} {kind}: settled after {team.errors[-1][0] - began - LONG_ENOUGH:.1f} s, then "
            f"mean {1e3 * sum(errors) / len(errors):.1f} mm, at most {1e3 * max(errors):.1f} mm"
        )
        assert_nothing_wrong_was_sent(team)
