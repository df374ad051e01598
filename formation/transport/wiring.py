"""Who links to whom: endpoints that each process listens on and dials.

The fleet's links follow the measurement graph and nothing else: no router, no multicast, no gossip; peers do
not relay. Of two robots that need a link the one listed later in the mission dials, so a mutual pair has one
link. The monitor dials every agent; nobody dials the monitor.

A robot's own side is apart from that: its agent, and at a desk the monitor, are clients of its router.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from formation.mission import Mission

AGENT_PORT = 7460
"""First port of agents that have no endpoint in the mission: robot number i listens on this plus i."""
ROBOT_PORT = 7660
"""The same for robots."""


class Endpoints(NamedTuple):
    """Where processes listen, by robot name."""

    agents: Mapping[str, str]
    """Each follower's agent, and the leader."""
    robots: Mapping[str, str]
    """Each follower's robot: its ROS 2 router, or the simulated one, which is a router as well."""


class Links(NamedTuple):
    """One process's Zenoh endpoints in the fleet."""

    listen: tuple[str, ...]
    connect: tuple[str, ...]


def endpoints(mission: Mission) -> Endpoints:
    """The mission's endpoints; where it names none, ports of this machine."""
    agents, robots = {}, {}
    for number, name in enumerate(mission.names):
        robot = mission.robots[name]
        agents[name] = robot.endpoint or f"tcp/127.0.0.1:{AGENT_PORT + number}"
        if name != mission.leader:
            robots[name] = robot.robot_endpoint or f"tcp/127.0.0.1:{ROBOT_PORT + number}"
    return Endpoints(agents, robots)


def partners(mission: Mission, name: str) -> tuple[str, ...]:
    """Robots that `name` needs a link with: those it measures and those that measure it, in mission order."""
    measured = set(mission.robots[name].neighbours)
    return tuple(
        other for other in mission.names if other in measured or name in mission.robots[other].neighbours
    )


def of_agent(mission: Mission, name: str, where: Endpoints) -> Links:
    """Links of a follower's agent with the fleet; besides, it is a client of ``where.robots[name]``."""
    return Links((where.agents[name],), _dialled(mission, name, where))


def of_leader(mission: Mission, where: Endpoints) -> Links:
    """Links of the leader: it is listed first, so it dials nobody."""
    return Links((where.agents[mission.leader],), ())


def of_robots(mission: Mission, names: Iterable[str], where: Endpoints) -> Links:
    """Links of a process that simulates `names` with the fleet: none, for what it is a router of is no fleet.

    Unless a simulated sensor looks at the virtual leader, which is nowhere but in its own position.
    """
    robots = [mission.robots[name] for name in names]
    looks = any(robot.measurement == "local" and mission.leader in robot.neighbours for robot in robots)
    return Links((), (where.agents[mission.leader],) if looks else ())


def of_monitor(where: Endpoints) -> Links:
    """Links of the monitor with the fleet: to everybody, because an agent shows it nothing but itself."""
    return Links((), tuple(where.agents.values()))


def by_endpoint(where: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """The robots behind each endpoint, in order."""
    behind: dict[str, tuple[str, ...]] = {}
    for robot, endpoint in where.items():
        behind[endpoint] = (*behind.get(endpoint, ()), robot)
    return behind


def under_certificates(ends: Iterable[str]) -> bool:
    """Whether somebody listens there who wants to see a certificate."""
    return any(end.startswith(("tls/", "quic/")) for end in ends)


def _dialled(mission: Mission, name: str, where: Endpoints) -> tuple[str, ...]:
    before = mission.names[: mission.names.index(name)]
    return tuple(where.agents[other] for other in partners(mission, name) if other in before)
