"""The process table of a mission on this machine: every process as data, a name and a command line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.wiring import Endpoints, Links

Part = Literal["control", "watchdog", "body", "watch"]
"""Role of a process: agent or candidate, watchdog, simulated robots, monitor."""
NO_LINKS = Links((), ())


class Program(NamedTuple):
    """One process to start."""

    name: str
    part: Part
    argv: tuple[str, ...]
    robots: tuple[str, ...] = ()
    """The robots that stand still without it."""


def leaders(mission: Mission) -> dict[str, str]:
    """Return the names of the candidates' processes, by candidate."""
    return {mission.leader: "leader", **{name: f"standby {name}" for name in mission.standbys}}


def programs(
    mission: Mission,
    source: str,
    where: Endpoints,
    *,
    parent: int,
    record: Path,
    law: str | None = None,
    watchdogs: bool = False,
    page: Sequence[str] = (),
    world: Sequence[str] = (),
    patience: float = 30.0,
    simulated: Sequence[str] = (),
) -> tuple[Program, ...]:
    """Return every process of `mission`, which each reads from `source`, in the order of starting.

    All end when the process `parent` dies; `watchdogs` adds one for each robot; `page` are the monitor's
    flags for its page, `world` those of the simulated robots, all or those named in `simulated`; `patience`
    [s] is how long they wait for the monitor before publishing, so that the recording is complete.
    """

    def program(name: str, part: Part, module: str, *flags: str, links: Links = NO_LINKS) -> Program:
        listen = [word for end in links.listen for word in ("-l", end)]
        connect = [word for end in links.connect for word in ("-e", end)]
        # -P: import nothing from the current folder
        command = (sys.executable, "-P", "-m", module, source, *flags, *listen, *connect)
        return Program(name, part, (*command, "--parent", str(parent)))

    def agent(name: str) -> Program:
        links = wiring.of_member(mission, name, where)
        one = program(
            f"agent {name}", "control", "formation.agent", *robot(name), *law_flag, *wait, links=links
        )
        return one._replace(robots=(name,))

    def leader(name: str) -> Program:
        flags = ("--standby", name) if name in mission.standbys else ()
        links = wiring.of_member(mission, name, where)
        return program(leaders(mission)[name], "control", "formation.leader", *flags, *wait, links=links)

    def watchdog(name: str) -> Program:
        return program(f"watchdog {name}", "watchdog", "formation.agent.watchdog", *robot(name))

    def robot(name: str) -> tuple[str, ...]:
        return "--robot", name, "--robot-connect", where.robots[name]

    law_flag = ("--law", law) if law else ()
    wait = ("--await-monitor", f"{patience:g}")
    stage = [word for name, end in where.robots.items() for word in ("--stage", f"{name}={end}")]
    watch = ("--record", str(record), "--snapshots", *law_flag, *page, *stage)
    only = [word for name in simulated for word in ("--robot", name)]
    bodies = tuple(where.robots[name] for name in simulated or mission.followers)
    robots = Links(bodies, wiring.of_robots(mission, mission.followers, where).connect)
    return (
        program("monitor", "watch", "formation.monitor", *watch, links=wiring.of_monitor(where)),
        program("robots", "body", "formation.agent.simulated", *only, *world, *wait, links=robots),
        *map(leader, mission.candidates),
        *(watchdog(name) for name in mission.followers if watchdogs),
        *(agent(name) for name in mission.followers),
    )
