"""The links between processes: endpoints on which each process listens and that it dials.

The fleet's links follow the measurement graph, with its fallbacks: no router, no multicast, no gossip;
peers do not relay. Candidates have further links: if there are standbys, each of them and the leader are
linked with all followers and each other; a leader that waits for robots is linked with these. Of
two linked processes the one listed later dials (the leader, then followers, then standbys), so a mutual
pair has one link. The monitor dials all processes; none dials the monitor.

A robot's own side is separate: its agent, and at a desk the monitor, are clients of its router.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Literal, NamedTuple

from formation.mission.model import Mission

Role = Literal["agent", "leader", "standby"]
AGENT_PORT = 7460
"""First default port: number i of `members` listens on this plus i if the mission names no endpoint."""
ROBOT_PORT = 7660
"""The same for robots."""


class Cause(StrEnum):
    """Why two processes are linked; the first that applies."""

    GRAPH = "graph"
    """One may measure the other."""
    AVOID = "avoid"
    """One avoids the other by the positions that it publishes."""
    LEADER = "leader"
    """One is the leader or a standby, and there are standbys, or the leader waits for its fleet."""


class Endpoints(NamedTuple):
    """Endpoints on which processes listen, by name."""

    agents: Mapping[str, str]
    """Each follower's agent, the leader, and the standbys."""
    robots: Mapping[str, str]
    """Each follower's robot: its ROS 2 router, or the simulated one, which is a router as well."""


class Links(NamedTuple):
    """One process's Zenoh endpoints in the fleet."""

    listen: tuple[str, ...]
    connect: tuple[str, ...]


def members(mission: Mission) -> tuple[str, ...]:
    """Names of all processes with endpoints in the fleet: the leader, the followers, the standbys."""
    return (*mission.names, *mission.standbys)


def role(mission: Mission, name: str) -> Role:
    """The kind of process with a name of `members`."""
    if name in mission.standbys:
        return "standby"
    return "leader" if name == mission.leader else "agent"


def named(mission: Mission) -> dict[str, str | None]:
    """The endpoint that the mission names for each of `members`, if it does."""
    return {
        **{name: mission.robots[name].endpoint for name in mission.names},
        **{name: standby.endpoint for name, standby in mission.standbys.items()},
    }


def endpoints(mission: Mission) -> Endpoints:
    """The mission's endpoints; ports of this machine where it names none."""
    agents = {
        name: given or f"tcp/127.0.0.1:{AGENT_PORT + number}"
        for number, (name, given) in enumerate(named(mission).items())
    }
    robots = {
        name: mission.robots[name].robot_endpoint or f"tcp/127.0.0.1:{ROBOT_PORT + number}"
        for number, name in enumerate(mission.names)
        if name != mission.leader
    }
    return Endpoints(agents, robots)


def partners(mission: Mission, name: str) -> tuple[str, ...]:
    """The processes with which `name`, a robot or a standby, needs a link, in the order of `members`."""
    return tuple(other for other in members(mission) if other != name and cause(mission, name, other))


def called(mission: Mission, name: str) -> tuple[str, ...]:
    """The processes that `name` dials: those of its partners that are listed before it."""
    order = members(mission)
    before = order[: order.index(name)]
    return tuple(other for other in partners(mission, name) if other in before)


def of_member(mission: Mission, name: str, where: Endpoints) -> Links:
    """Links with the fleet of one of `members`. The leader is listed first, so it dials none."""
    return Links((where.agents[name],), _endpoints(called(mission, name), where))


def of_robots(mission: Mission, names: Iterable[str], where: Endpoints) -> Links:
    """Links with the fleet of a process that simulates `names`: none, as it is only a router of their robots.

    If a simulated sensor measures the virtual leader, which exists only in its own position, the
    candidates are dialled.
    """
    robots = [mission.robots[name] for name in names]
    looks = any(robot.measurement == "local" and mission.leader in robot.measurable for robot in robots)
    return Links((), _endpoints(mission.candidates, where) if looks else ())


def of_monitor(where: Endpoints) -> Links:
    """Links of the monitor with the fleet: to all processes, because agents do not relay."""
    return Links((), tuple(where.agents.values()))


def by_endpoint(where: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """The robots behind each endpoint, in order."""
    behind: dict[str, tuple[str, ...]] = {}
    for robot, endpoint in where.items():
        behind[endpoint] = (*behind.get(endpoint, ()), robot)
    return behind


def under_certificates(ends: Iterable[str]) -> bool:
    """Whether an endpoint requires certificates."""
    return any(end.startswith(("tls/", "quic/")) for end in ends)


def certificate_remedy(visitor: str) -> str:
    """What to do if robots with certificates do not answer `visitor`, as it shows none."""
    return (
        f"robots with certificates answer only the {visitor}: name the folder of their bundles in place of"
        f" the mission file, or the {visitor}'s configuration with -c FILE"
    )


def _endpoints(names: Iterable[str], where: Endpoints) -> tuple[str, ...]:
    return tuple(where.agents[name] for name in names)


def cause(mission: Mission, one: str, other: str) -> Cause | None:
    """Why two of `members` are linked; None if they are not."""
    pair = {one, other}
    robots = pair & mission.robots.keys()
    if any(not pair.isdisjoint(mission.robots[name].measurable) for name in robots):
        return Cause.GRAPH
    if any(not pair.isdisjoint(mission.avoided_by(name)) for name in robots):
        return Cause.AVOID
    candidates = pair.intersection(mission.candidates)
    ballots = mission.standbys and candidates
    waits = mission.leader in pair and not pair.isdisjoint(mission.waited_for)
    return Cause.LEADER if ballots or waits else None
