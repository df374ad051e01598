"""The fleet is decentralised: subscriptions, publications, links and ports of each running process."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from formation.deploy.local.plan import programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.mission.model import Mission
from formation.topics import (
    ALIVE,
    BALLOT,
    CMD_VEL,
    ODOM,
    ORDER,
    POSITION,
    ROUTE,
    SCAN,
    STATUS,
    Topic,
)
from formation.transport.wiring import Endpoints, partners
from tests.support.child import PATIENCE, Child, started
from tests.support.launched import LONGEST_START
from tests.support.zenoh_admin import Peer, clients, inspect

pytestmark = pytest.mark.processes
MISSIONS = (
    pytest.param("turtlebot3_pair", marks=pytest.mark.slow),
    pytest.param("convoy", marks=pytest.mark.slow),
    "patrol",
)
"""Robots that avoid each other, a leader that waits for its robots, and standbys with fallback neighbours."""


class Team:
    """Every process of a mission, running."""

    def __init__(self, mission: Mission, where: Endpoints, children: dict[str, Child]) -> None:
        self.mission, self.where, self.children = mission, where, children


@contextmanager
def running(name: str, record: Path) -> Iterator[Team]:
    mission = load(name)
    with ExitStack() as stack:
        where = stack.enter_context(Ports(mission)).endpoints
        flags = ("--no-page",)  # a page has sockets that are no part of the fleet
        plan = programs(
            mission, name, where, parent=os.getpid(), record=record, page=flags, patience=LONGEST_START
        )
        children = {}
        for program in plan:
            module, *arguments = program.argv[program.argv.index("-m") + 1 :]
            children[program.name] = stack.enter_context(started(module, *arguments))
        for child in children.values():
            child.event("ready", LONGEST_START)
        team = Team(mission, where, children)
        wait_until_linked(team)
        yield team


@pytest.fixture(scope="module", params=MISSIONS)
def team(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    """Start a team, which tests must not change."""
    with running(request.param, tmp_path_factory.mktemp("team") / "run.mcap") as team:
        yield team


def wait_until_linked(team: Team) -> None:
    """Wait until all links are up: processes that start together link one by one."""
    deadline = time.monotonic() + PATIENCE
    while any(len(peer.links) < expected_links(team, name) for name, peer in peers(team).items()) or any(
        len(found) < 2 for found in behind_robots(team).values()
    ):
        assert time.monotonic() < deadline, "the team did not link up"


def expected_links(team: Team, name: str) -> int:
    """Return the number of links of a process: with its partners and the monitor."""
    return len(partners(team.mission, name)) + 1


def peers(team: Team) -> dict[str, Peer]:
    """Return every agent, the leader and the standbys on the fleet's bus, by name."""
    return {name: inspect(endpoint) for name, endpoint in team.where.agents.items()}


def behind_robots(team: Team) -> dict[str, list[Peer]]:
    """Return the clients of every robot's router, by robot."""
    return {robot: clients(endpoint) for robot, endpoint in team.where.robots.items()}


def port(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


def connections(child: Child, status: str) -> list[Any]:
    every = psutil.Process(child.process.pid).net_connections("inet")
    return [one for one in every if one.status == status]


def listening(child: Child) -> set[int]:
    return {one.laddr.port for one in connections(child, psutil.CONN_LISTEN)}


def robot_keys(robot: str, *topics: Topic) -> set[str]:
    return {topic.key(robot) for topic in topics}


def keys(topic: Topic, names: Iterable[str]) -> set[str]:
    return {topic.key(name) for name in names}


def test_agent_subscribes_to_its_neighbours_only(team: Team) -> None:
    """In a mission with standbys, also to the candidates' ballots."""
    seen, mission = peers(team), team.mission
    for robot in mission.followers:
        positions = keys(POSITION, mission.robots[robot].measurable)
        requested = keys(BALLOT, mission.candidates) if mission.standbys else set()
        assert seen[robot].subscriptions == positions | requested
        assert seen[robot].queryables == {ORDER.key(robot)}


def test_candidates_subscribe_to_linked_agents_only(team: Team) -> None:
    """With standbys, each candidate subscribes to all followers and to the other candidates."""
    seen, mission = peers(team), team.mission
    measure = {i for i in mission.followers if mission.leader in mission.robots[i].neighbours}
    for name in mission.candidates:
        others = [one for one in mission.candidates if one != name]
        agreed = keys(POSITION, mission.followers) | keys(BALLOT, others) | keys(ROUTE, others)
        assert seen[name].subscriptions == (agreed if mission.standbys else keys(POSITION, measure))
        assert seen[name].queryables == {ORDER.key(name)}


def test_fleet_processes_publish_only_their_own_keys(team: Team) -> None:
    """A candidate also publishes the leader's position, when it leads."""
    mission = team.mission
    for name, peer in peers(team).items():
        if name in mission.followers:
            assert peer.publications == robot_keys(name, POSITION, STATUS, CMD_VEL, ODOM, SCAN)
        else:
            agreed = robot_keys(name, BALLOT, ROUTE) if mission.standbys else set()
            assert peer.publications == {POSITION.key(mission.leader), STATUS.key(name)} | agreed


def test_agent_uses_only_its_own_keys_at_robot_router(team: Team) -> None:
    for robot, found in behind_robots(team).items():
        (agent,) = [one for one in found if one.name == "formation_agent"]
        # a sign of life of another publisher shows that another agent commands the robot
        assert agent.subscriptions == robot_keys(robot, ODOM, SCAN, ALIVE)
        assert agent.publications == robot_keys(robot, CMD_VEL, ALIVE, POSITION, STATUS)
        assert agent.queryables == set()


@pytest.mark.smoke
def test_fleet_links_are_those_of_graph_and_monitor(
    team: Team,
) -> None:
    seen = peers(team)
    names = {peer.zid: robot for robot, peer in seen.items()}
    strangers = set()
    for robot, peer in seen.items():
        linked = {names[zid] for zid in peer.links if zid in names}
        assert linked == set(partners(team.mission, robot))
        assert len(peer.links) == expected_links(team, robot)
        assert set(peer.links.values()) == {1}
        strangers |= {zid for zid in peer.links if zid not in names}
    assert len(strangers) == 1  # the monitor's session, which is linked with all


def test_agent_has_one_link_to_its_robot_router(team: Team) -> None:
    agents = {peer.zid for peer in peers(team).values()}
    for robot, found in behind_robots(team).items():
        router = inspect(team.where.robots[robot])
        assert router.kinds == {"client"}
        assert sorted(one.name for one in found) == ["formation_agent", "formation_monitor"]
        for one in found:
            assert one.links == {router.zid: 1}
            assert one.kinds == {"router"}
            assert one.locators == ()
        assert not agents & set(router.links)  # the agent has another session in the fleet


@pytest.mark.smoke
def test_agent_dials_only_earlier_partners_and_its_robot(team: Team) -> None:
    for robot in team.mission.followers:
        dialled = [
            one.raddr.port
            for one in connections(team.children[f"agent {robot}"], psutil.CONN_ESTABLISHED)
            if one.laddr.port != port(team.where.agents[robot])
        ]
        before = team.mission.names[: team.mission.names.index(robot)]
        wanted = [
            port(team.where.agents[other]) for other in partners(team.mission, robot) if other in before
        ]
        assert sorted(dialled) == sorted([*wanted, port(team.where.robots[robot])])


def test_fleet_has_no_router_and_no_multicast(team: Team) -> None:
    for peer in peers(team).values():
        assert peer.kinds == {"peer"}
    expected = {port(end) for end in endpoints(team)}
    received = set()
    for child in team.children.values():
        process = psutil.Process(child.process.pid)
        assert not [one for one in process.net_connections("inet") if one.type.name == "SOCK_DGRAM"]
        received |= listening(child)
    assert received == expected


def test_each_process_listens_only_on_its_own_endpoints(team: Team) -> None:
    wanted = {
        "monitor": set[int](),
        "robots": {port(end) for end in team.where.robots.values()},
        "leader": {port(team.where.agents[team.mission.leader])},
        **{f"standby {name}": {port(team.where.agents[name])} for name in team.mission.standbys},
        **{f"agent {robot}": {port(team.where.agents[robot])} for robot in team.mission.followers},
    }
    assert {name: listening(child) for name, child in team.children.items()} == wanted


def endpoints(team: Team) -> tuple[str, ...]:
    return (*team.where.agents.values(), *team.where.robots.values())
