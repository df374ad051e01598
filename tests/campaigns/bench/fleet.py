"""A fleet of real processes on loopback: bodies, a leader, and agents or the central node that drive them."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, NamedTuple

import psutil

from formation.mission.file import load
from formation.mission.model import Mission
from formation.transport import wiring
from tests.campaigns.bench.processes import LISTING, Running, accounts, memory, used
from tests.campaigns.figures import progress
from tests.support.child import free_endpoint

LEADER = "leader"
APART = 1.0
"""Between neighbours in a row, and between rows [m]."""
SPEED, RADIUS = 0.2, 2.0
"""The leader's, on a circle: on a straight line no robot would be off, however late [m/s; m]."""
OFFSET = 0.2
"""Control-point offset of every follower [m]."""


def mission(followers: int, rate: float) -> str:
    """The file of a mission of so many followers, everybody at `rate` [Hz]; all start in their slots."""
    wide = max(2, round(math.sqrt(followers)))  # about as many as there are rows: none is far from the leader
    places = [divmod(number, wide) for number in range(followers)]
    slots = [APART * complex(-1 - row, column - 0.5 * (wide - 1)) for row, column in places]
    lines = ['name = "block"', f'leader = "{LEADER}"', "[robot]", f"control_point_offset = {OFFSET}"]
    lines += ["max_speed = 1.5", "max_turn_rate = 1.5", f"rate = {rate:g}", "[shapes.block]"]
    lines += [f"{_name(*place)} = [{at.real}, {at.imag}]" for place, at in zip(places, slots, strict=True)]
    lines += [f"[robots.{LEADER}]", "start = { x = 0.0, y = 0.0 }"]
    for (row, column), at in zip(places, slots, strict=True):
        measured = (_name(row - 1, column), _name(row - 1, (column + 1) % wide)) if row else (LEADER,)
        lines += [f"[robots.{_name(row, column)}]", f"neighbours = {list(measured)}"]
        lines += [f"start = {{ x = {at.real - OFFSET}, y = {at.imag} }}"]
    return "\n".join([*lines, "[[route]]", f"speed = {SPEED}", f"radius = {RADIUS}", "heading_deg = 0", ""])


def typical(block: Mission) -> tuple[str, ...]:
    """Followers that measure two others and are measured by two, as the first and last rows do not."""
    measured = Counter(name for robot in block.robots.values() for name in robot.neighbours)
    middle = (name for name in block.followers if LEADER not in block.robots[name].neighbours)
    return tuple(name for name in middle if measured[name] == 2)


def _name(row: int, column: int) -> str:
    return f"robot{row:02}{column:02}"


RATE = 10.0
"""Of every robot's odometry and of the leader [Hz]."""
QUICK = {"settle": 2.0, "seconds": 4.0}
"""Times of the short form [s]."""
QUIET = ("--log-level", "error", "--parent", str(os.getpid()))
AT_ONCE = 4
"""Number of drivers that may be starting at a time."""
Architecture = Literal["agents", "central"]


class Outcome(NamedTuple):
    """What came of one fleet."""

    robots: dict[str, Any]
    """What the bodies say: latency, late periods, error."""
    drivers: dict[str, dict[str, float]]
    """What each agent takes, by robot, or the central node alone."""
    typical: tuple[str, ...]
    """Robots that measure two others and are measured by two."""
    others: dict[str, float]
    """CPU of the bodies' process and of the leader [% of one core]."""
    start_s: float
    """From the start of the first driver until every robot has been told to move."""


class Fleet:
    """A block of so many followers, and the leader."""

    def __init__(self, followers: int, architecture: Architecture, folder: Path) -> None:
        self._file = folder / f"{followers}.toml"
        self._file.write_text(mission(followers, RATE))
        self._mission = load(self._file)
        ends = [free_endpoint() for _ in range(1 + 2 * followers)]
        self._ends = dict(zip(self._mission.names, ends[: 1 + followers], strict=True))
        self._robots = dict(zip(self._mission.followers, ends[1 + followers :], strict=True))
        self._central = architecture == "central"
        self._log = folder / f"{followers}-{architecture}.log"

    def run(self, settle: float, seconds: float) -> Outcome:
        """Start everybody, let them `settle`, measure for `seconds` and end them.

        Raises RuntimeError if somebody does not do its part.
        """
        leader_end = self._ends[self._mission.leader]
        plan = {
            "mission": str(self._file), "leader": leader_end, "robots": self._robots,
            "settle": settle, "seconds": seconds,
        }  # fmt: skip
        with ExitStack() as stack:
            log = stack.enter_context(self._log.open("w"))

            def started(arguments: list[str]) -> Running:
                return stack.enter_context(Running(*arguments, log=log))

            bodies = started(["tests.campaigns.bench.bodies", json.dumps(plan)])
            bodies.wait_for("ready")
            others = {
                "bodies": bodies.process,
                "leader": started(["leader", str(self._file), "-l", leader_end, *QUIET]).process,
            }
            begun = time.monotonic()
            drivers = self._drivers(started)
            moving = bodies.wait_for("moving")["moment"] - begun
            bodies.wait_for("settled")
            everybody = {**others, **drivers}
            pids = [process.pid for process in everybody.values()]
            before = accounts(pids)
            figures = bodies.wait_for("measured")
            after = accounts(pids)
            took = {name: used(before[one.pid], after[one.pid]) for name, one in everybody.items()}
            return Outcome(
                {name: found for name, found in figures.items() if name != "event"},
                {name: {**took[name], **memory(process)} for name, process in drivers.items()},
                typical(self._mission),
                {name: took[name]["cpu_percent"] for name in others},
                moving,
            )

    def _drivers(self, start: Callable[[list[str]], Running]) -> dict[str, psutil.Popen]:
        """Start all drivers, a few at a time: one without CPU gives up its links, and makes them anew."""
        running: dict[str, Running] = {}
        for name, argv in self._argv().items():
            running[name] = start(argv)
            if len(running) >= AT_ONCE:
                list(running.values())[-AT_ONCE].wait_for("ready")
        return {name: one.process for name, one in running.items()}

    def _argv(self) -> dict[str, list[str]]:
        """What ``python -m`` is given for each that drives."""
        if self._central:
            dial = [self._ends[self._mission.leader], *self._robots.values()]
            plan = {"mission": str(self._file), "dial": dial}
            return {"central": ["tests.campaigns.bench.central", json.dumps(plan)]}
        return {name: self._agent(name) for name in self._mission.followers}

    def _agent(self, name: str) -> list[str]:
        dialled = [word for to in wiring.called(self._mission, name) for word in ("-e", self._ends[to])]
        ends = ["--robot-connect", self._robots[name], "-l", self._ends[name], *dialled]
        return ["agent", str(self._file), "--robot", name, *QUIET, *ends]


def trials(
    rounds: int,
    turns: Callable[[int], Iterable[tuple[int, Architecture]]],
    settle: float = 10.0,
    seconds: float = 10.0,
) -> tuple[float, list[dict[tuple[int, Architecture], Outcome]]]:
    """How long each fleet is measured [s], and what came of every round's fleets.

    `turns` has the followers and the architectures of a round in order; a fleet has `settle` [s] from
    everybody on the way to everybody in formation.
    """
    if shutil.which(LISTING[0]) is None:
        raise SystemExit(f"needs {LISTING[0]}, which counts what goes over each link: apt install iproute2")
    found: list[dict[tuple[int, Architecture], Outcome]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            found.append({})
            for count, how in turns(number):
                progress(f"round {number + 1} of {rounds}: {count} robots, {how} …")
                found[-1][count, how] = Fleet(count, how, Path(folder)).run(settle, seconds)
    return seconds, found
