"""The process table of a mission on this machine: every process as data, a name and a command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal, NamedTuple

from formation import wiring
from formation.mission import Mission
from formation.wiring import Endpoints, Links

Part = Literal["control", "body", "watch"]
"""What a process is to the run: an agent or the leader, the simulated robots, the monitor."""


class Program(NamedTuple):
    """One process to start."""

    name: str
    part: Part
    argv: tuple[str, ...]
    robots: tuple[str, ...] = ()
    """The robots that stand still without it."""


def programs(
    mission: Mission,
    source: str,
    where: Endpoints,
    *,
    parent: int,
    record: Path,
    law: str | None = None,
    patience: float = 30.0,
) -> tuple[Program, ...]:
    """Every process of `mission`, read from `source` by each of them, in the order of starting.

    `parent` is the process whose death ends them all; `patience` [s] is how long they wait for the monitor
    before they publish anything, so that the recording misses nothing.
    """

    def program(name: str, part: Part, module: str, links: Links, *flags: str) -> Program:
        listen = [word for end in links.listen for word in ("-l", end)]
        connect = [word for end in links.connect for word in ("-e", end)]
        # -P: what lies in the folder where the user happens to be is not imported
        command = (sys.executable, "-P", "-m", module, source, *flags, *listen, *connect)
        return Program(name, part, (*command, "--parent", str(parent)))

    def agent(name: str) -> Program:
        links = wiring.of_agent(mission, name, where)
        return program(f"agent {name}", "control", "agent", links, "--robot", name, *law_flag, *wait)

    law_flag = ("--law", law) if law else ()
    wait = ("--await-monitor", f"{patience:g}")
    watch = ("--record", str(record), "--snapshots", *law_flag)
    return (
        program("monitor", "watch", "monitor", wiring.of_monitor(where), *watch),
        program("robots", "body", "agent.robots", wiring.of_robots(mission, mission.followers, where), *wait),
        program("leader", "control", "leader", wiring.of_leader(mission, where), *wait),
        *(agent(name)._replace(robots=(name,)) for name in mission.followers),
    )
