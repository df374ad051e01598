"""Nothing in the middle: what each running process hears, whom it is linked with, and who is not needed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import psutil
import pytest

from deploy.plan import programs
from deploy.ports import Ports
from formation.bus import Bus, BusConfig
from formation.messages import Pose, Twist, decode
from formation.mission import Mission
from formation.mission_file import load
from formation.topics import CMD_VEL, GROUND_TRUTH, ODOM, ORDER, POSITION
from formation.wire import Sample
from formation.wiring import Endpoints, partners
from tests.processes.child import PATIENCE, Child, started
from tests.processes.zenoh_admin import Peer, inspect

pytestmark = pytest.mark.processes
SIX = load("six_robots")


class Team:
    """Every process of a mission, running."""

    def __init__(self, mission: Mission, where: Endpoints, children: dict[str, Child]) -> None:
        self.mission, self.where, self.children = mission, where, children


@contextmanager
def running(record: Path) -> Iterator[Team]:
    with ExitStack() as stack:
        where = stack.enter_context(Ports(SIX)).endpoints
        plan = programs(SIX, "six_robots", where, parent=os.getpid(), record=record, patience=PATIENCE)
        children = {}
        for program in plan:
            module, *arguments = program.argv[program.argv.index("-m") + 1 :]
            children[program.name] = stack.enter_context(started(module, *arguments))
        for child in children.values():
            child.event("ready")
        team = Team(SIX, where, children)
        wait_until_linked(team)
        yield team


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    """A running team that tests only look at."""
    with running(tmp_path_factory.mktemp("team") / "run.mcap") as team:
        yield team


def wait_until_linked(team: Team) -> None:
    """Processes that start together find each other one by one."""
    deadline = time.monotonic() + PATIENCE
    while any(len(peer.links) < expected_links(robot) for robot, peer in peers(team).items()):
        assert time.monotonic() < deadline, "the team did not link up"


def expected_links(robot: str) -> int:
    """Its partners, the monitor and its own robot; the virtual leader has no robot."""
    return len(partners(SIX, robot)) + 1 + (robot != SIX.leader)


def peers(team: Team) -> dict[str, Peer]:
    """Every agent and the leader, by robot."""
    return {robot: inspect(endpoint) for robot, endpoint in team.where.agents.items()}


def listening(child: Child) -> set[int]:
    connections = psutil.Process(child.process.pid).net_connections("inet")
    return {one.laddr.port for one in connections if one.status == psutil.CONN_LISTEN}


def test_every_agent_hears_its_own_odometry_and_its_neighbours_positions_and_nothing_else(team: Team) -> None:
    for robot, peer in peers(team).items():
        neighbours = {POSITION.key(other) for other in SIX.robots[robot].neighbours}
        own = set() if robot == SIX.leader else {ODOM.key(robot)}
        assert peer.subscriptions == own | neighbours
        assert peer.queryables == {ORDER.key(robot)}


def test_every_link_is_one_that_the_measurement_graph_asks_for(team: Team) -> None:
    seen = peers(team)
    names = {peer.zid: robot for robot, peer in seen.items()}
    for robot, peer in seen.items():
        linked = {names[zid] for zid in peer.links if zid in names}
        assert linked == set(partners(SIX, robot))
        assert len(peer.links) == expected_links(robot)
        assert set(peer.links.values()) == {1}


def test_there_is_no_router_and_no_multicast(team: Team) -> None:
    for peer in peers(team).values():
        assert peer.kinds == {"peer"}
    expected = {int(end.rpartition(":")[2]) for end in endpoints(team)}
    heard = set()
    for child in team.children.values():
        process = psutil.Process(child.process.pid)
        assert not [one for one in process.net_connections("inet") if one.type.name == "SOCK_DGRAM"]
        heard |= listening(child)
    assert heard == expected


def test_each_process_is_an_operating_system_process_of_its_own(team: Team) -> None:
    assert len({child.process.pid for child in team.children.values()}) == len(SIX.names) + 2


def endpoints(team: Team) -> tuple[str, ...]:
    return (*team.where.agents.values(), *team.where.robots.values())


class Witness:
    """A stranger who only looks on: true poses of the robots, and every command."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.commands, self.poses = bus, list[Sample](), dict[str, Pose]()

    def watch(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.bus.wait(left)
            for sample in self.bus.drain():
                if sample.key.endswith("/cmd_vel"):
                    self.commands.append(sample)
                else:
                    self.poses[sample.key] = decode(Pose, sample.payload)

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

    def longest_silence(self, robot: str) -> float:
        times = [sample.arrived for sample in self.commands if sample.key == CMD_VEL.key(robot)]
        return max(later - earlier for earlier, later in pairwise(times))


def test_killing_the_monitor_changes_nothing(tmp_path: Path) -> None:
    with running(tmp_path / "run.mcap") as team, Bus(BusConfig(connect=endpoints(team))) as bus:
        bus.subscribe(POSITION.key(SIX.leader))
        for robot in SIX.followers:
            bus.subscribe(CMD_VEL.key(robot))
            bus.subscribe(GROUND_TRUTH.key(robot))
        witness = Witness(bus)
        witness.watch(4.0)
        witness.commands.clear()
        team.children["monitor"].signal(signal.SIGKILL)
        witness.watch(8.0)
        assert witness.error() < 0.01
        for robot in SIX.followers:
            assert decode(Twist, witness.commands[-1].payload).speed != 0.0
            assert witness.longest_silence(robot) < 0.5
        survivors = [name for name, child in team.children.items() if child.process.poll() is None]
        assert set(survivors) == set(team.children) - {"monitor"}
