"""The process table of a mission on this machine: every process as data, a name and a command line."""

from __future__ import annotations

import sys
from collections.abc import Iterable
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
    """The robots it controls or simulates."""


def programs(
    mission: Mission,
    source: str,
    where: Endpoints,
    *,
    parent: int,
    record: Path,
    law: str | None = None,
    patience: float = 15.0,
) -> tuple[Program, ...]:
    """Every process of `mission`, read from `source` by each of them, in the order of starting.

    `parent` is the process whose death ends them all; `patience` [s] is how long they wait for the monitor
    before they publish anything, so that the recording misses nothing.
    """

    def program(
        name: str, part: Part, module: str, links: Links, *flags: str, robots: Iterable[str]
    ) -> Program:
        ends = [
            *(part for end in links.listen for part in ("-l", end)),
            *(part for end in links.connect for part in ("-e", end)),
        ]
        # -P: what lies in the folder where the user happens to be is not imported
        argv = (sys.executable, "-P", "-m", module, source, *flags, *ends, "--parent", str(parent))
        return Program(name, part, argv, tuple(robots))

    wait = ("--await-monitor", f"{patience:g}")
    override = ("--law", law) if law else ()
    monitor = ("--record", str(record), "--snapshots")
    agents = [
        program(
            f"agent {name}", "control", "agent", wiring.of_agent(mission, name, where),
            "--robot", name, *wait, *override, robots=[name],
        )
        for name in mission.followers
    ]  # fmt: skip
    return (
        program("monitor", "watch", "monitor", wiring.of_monitor(where), *monitor, robots=()),
        program(
            "robots", "body", "agent.robots", wiring.of_robots(mission.followers, where), *wait,
            robots=mission.followers,
        ),
        program(
            "leader", "control", "leader", wiring.of_leader(mission, where), *wait, robots=[mission.leader]
        ),
        *agents,
    )  # fmt: skip
