"""Bar: whatever becomes of an agent while it drives, its robot's wheels are at zero within 0.3 s.

Over real processes: leader, agents, watchdogs, simulated robots. What a robot does is read from its own
odometry, so each figure is up to a period (0.05 s) too long. ``pytest -s`` shows all of them. Where that is
allowed, processes have the priorities that they have on a robot, whatever else this machine does.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from formation.transport.wiring import Endpoints
from tests.processes.agent.relay import Relay
from tests.processes.agent.watchdog_team import (
    NICE,
    ROBOTS,
    ROUNDS,
    WITHIN,
    Runs,
    Team,
    summary_of,
    tries,
    unstalled,
)
from tests.support.child import Child, free_endpoint, niced, started
from tests.support.namespaces import Field, Running

pytestmark = pytest.mark.processes


class Here:
    """Processes of this machine."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack

    def __call__(self, _name: str, module: str, arguments: list[str]) -> Runs:
        child: Child = self._stack.enter_context(started(module, *arguments, nice=NICE.get(module, 0)))
        return child


@contextmanager
def team_here(folder: Path) -> Iterator[Team]:
    names = ("robot1", *ROBOTS)
    where = Endpoints({n: free_endpoint() for n in names}, {n: free_endpoint() for n in ROBOTS})
    with ExitStack() as stack:
        yield Team(Here(stack), folder, where)


def report(kind: str, took: list[float]) -> None:
    print(f"\n{summary_of(kind, took)}")
    assert len(took) == ROUNDS * len(ROBOTS) == 20
    assert max(took) <= WITHIN, summary_of(kind, took)


def test_killed_agents_robot_stops_within_300_ms(
    tmp_path: Path,
) -> None:
    """20 of 20 times, and a new agent drives the robot again."""
    with team_here(tmp_path) as team:
        team.start(*ROBOTS)
        took = tries(team, lambda name: os.kill(team.agents[name].pid, signal.SIGKILL), team.start)
        report("kill -9", took)


def test_hanging_agents_robot_stops_within_300_ms(
    tmp_path: Path,
) -> None:
    """20 of 20 times, and the agent drives the robot again."""
    with team_here(tmp_path) as team:
        team.start(*ROBOTS)

        def go_on(*names: str) -> None:
            for name in names:
                os.kill(team.agents[name].pid, signal.SIGCONT)

        took = tries(team, lambda name: os.kill(team.agents[name].pid, signal.SIGSTOP), go_on)
        report("SIGSTOP", took)


def test_robot_stops_within_300_ms_of_cut_links(tmp_path: Path) -> None:
    """20 of 20 times that the agent's links with the fleet are cut."""
    with ExitStack() as stack, team_here(tmp_path) as team:
        leader = team.mission.robots["robot1"].endpoint
        assert leader is not None
        cables = {name: stack.enter_context(Relay(leader)) for name in ROBOTS}
        flags = {
            name: ["-l", str(team.mission.robots[name].endpoint), "-e", cable.endpoint]
            for name, cable in cables.items()
        }
        team.start(*ROBOTS, flags=flags)

        def mend(*names: str) -> None:
            for name in names:
                cables[name].mend()

        took = tries(team, lambda name: cables[name].cut(), mend)
        report("fleet links cut", took)


class Elsewhere:
    """Every agent on a computer of its own; the robots with their watchdogs, and the leader, on one each."""

    def __init__(self, field: Field) -> None:
        self.computers = {name: field.computer(name) for name in ("robots", "leader", *ROBOTS)}
        address = {name: computer.address for name, computer in self.computers.items()}
        self.where = Endpoints(
            {"robot1": f"tcp/{address['leader']}:7460"} | {n: f"tcp/{address[n]}:7460" for n in ROBOTS},
            {n: f"tcp/{address['robots']}:{7660 + i}" for i, n in enumerate(ROBOTS)},
        )

    def __call__(self, name: str, module: str, arguments: list[str]) -> Runs:
        computer = self.computers.get(name, self.computers["robots"])
        nice = niced(NICE.get(module, 0))
        running: Running = computer.start(*nice, sys.executable, "-m", module, *arguments)
        return running


@pytest.mark.namespaces
def test_robot_stops_within_300_ms_of_unplugged_agent(tmp_path: Path) -> None:
    """20 of 20 times that the agent's computer is unplugged."""
    with Field() as field:
        there = Elsewhere(field)
        team = Team(there, tmp_path, there.where)
        team.start(*ROBOTS)

        def plug(*names: str) -> None:
            for name in names:
                there.computers[name].plug()

        report("unplugged", tries(team, lambda name: there.computers[name].unplug(), plug))


@pytest.mark.namespaces
def test_an_agent_that_is_unplugged_costs_the_other_robots_nothing(tmp_path: Path) -> None:
    with Field() as field:
        there = Elsewhere(field)
        team = Team(there, tmp_path, there.where)
        team.start(*ROBOTS)
        team.settle(*ROBOTS)  # the first may have been held up while the last one was waited for
        lost, *others = ROBOTS
        before = time.time()
        there.computers[lost].unplug()
        team.wheels.until(lambda: time.time() > before + 4.0, "four leases and more")
        there.computers[lost].plug()
        team.settle(lost)
        for name in others:
            drove = [one for one in team.wheels.moving[name] if one.stamp > before]
            judged = [one for one in unstalled(team.wheels.moving[name]) if one.stamp > before]
            assert len(judged) > 0.5 * len(drove), f"{name}: this machine stalled all the time"
            assert min(one.speed for one in judged) > 0.1, f"{name} stood: {judged}"
            assert max(later.stamp - earlier.stamp for earlier, later in pairwise(drove)) < 0.3
