"""Two agents of one robot in the halves of a cut network, as real processes: never two leaders.

FORMATION_TWO_AGENTS=20 pytest -s tests/processes/agent/test_two_agents.py   for 20 random orders and moments
"""

from __future__ import annotations

import os
import random
import signal
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from formation.mission.file import load
from formation.ros2.messages import Diagnostics, decode
from formation.topics import STATUS
from formation.transport.bus import Bus, BusConfig
from tests.support.child import PATIENCE, Child, free_endpoint, started
from tests.support.row_of_three import row_of_three

pytestmark = [pytest.mark.processes, pytest.mark.timeout(180)]
TIMES = int(os.environ.get("FORMATION_TWO_AGENTS", "1"))
MISSION = row_of_three(
    "halves", rate=20, speed=0.05, neighbours=('["led"]',) * 3, behind=0.0, tables="[standbys.deputy]"
)
HALVES = {"led": ("a", "b"), "deputy": ("b", "c")}
"""Who may lead in each half, and the robots whose agents are there: b has one in both."""
WATCHED = 6.0
"""[s]"""


class Halves:
    """Both halves, and what their candidates say of themselves."""

    def __init__(self, stack: ExitStack, file: Path, draw: random.Random, *flags: str) -> None:
        self.agents: dict[tuple[str, str], Child] = {}
        self.leading: dict[str, list[float]] = {name: [] for name in HALVES}
        self._file, self._stack = file, stack
        load(file)
        robots = {name: free_endpoint() for name in "abc"}
        hubs = {name: free_endpoint() for name in HALVES}
        for name, endpoint in robots.items():
            self._start("formation.agent.simulated", "--robot", name, "-l", endpoint)
        starts = [("leader", half, "") for half in HALVES]
        starts += [("agent", half, robot) for half, names in HALVES.items() for robot in names]
        draw.shuffle(starts)
        for kind, half, robot in starts:
            time.sleep(draw.uniform(0.0, 0.5))
            if kind == "leader":
                standby = ("--standby",) if half == "deputy" else ()
                self._start("formation.leader", "-l", hubs[half], *standby)
            else:
                more = flags if (half, robot) == ("deputy", "b") else ()
                ends = ("-l", free_endpoint(), "-e", hubs[half], "--robot-connect", robots[robot])
                self.agents[half, robot] = self._start("formation.agent", "--robot", robot, *ends, *more)
        self._bus = stack.enter_context(Bus(BusConfig(connect=tuple(hubs.values()))))
        for half in HALVES:
            self._bus.subscribe(STATUS.key(half))

    def watch(self, seconds: float, *, until: str = "") -> None:
        """Listen; at most until this candidate leads."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0 and not (until and self.leading[until]):
            self._bus.wait(left)
            for sample in self._bus.drain():
                (result,) = decode(Diagnostics, sample.payload).statuses
                if result.values["leads"] == "true":
                    self.leading[sample.key.split("/")[0]].append(sample.arrived)

    def _start(self, module: str, *arguments: str) -> Child:
        child = self._stack.enter_context(started(module, str(self._file), *arguments))
        child.event("ready")
        return child


@pytest.mark.parametrize("number", range(TIMES))
@pytest.mark.parametrize("flags", [(), ("--readonly",)], ids=["commanding", "readonly"])
def test_cut_network_with_two_agents_has_one_leader(
    tmp_path: Path, flags: tuple[str, ...], number: int
) -> None:
    file = tmp_path / "halves.toml"
    file.write_text(MISSION)
    with ExitStack() as stack:
        halves = Halves(stack, file, random.Random(number), *flags)
        halves.watch(WATCHED)
        assert not halves.leading["deputy"], "its half has one vote of three, and a half of another"
        if not flags:
            assert not halves.leading["led"]
            halves.agents["deputy", "b"].signal(signal.SIGTERM)
        halves.watch(PATIENCE, until="led")
        assert halves.leading["led"]
        assert not halves.leading["deputy"]
