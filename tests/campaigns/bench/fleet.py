"""A fleet of real processes on loopback: bodies, a leader, and agents or the central node that drive them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, NamedTuple, Self

import psutil

from formation.mission.file import load
from formation.transport import wiring
from tests.campaigns.bench.accounting import accounts, memory, used
from tests.campaigns.bench.block import mission, typical
from tests.campaigns.bench.compiled import ready_to_start
from tests.support.child import free_endpoint

RATE = 10.0
"""Of every robot's odometry and of the leader [Hz]."""
SETTLE = 10.0
"""From everybody on the way to everybody in formation [s]."""
QUIET = ("--log-level", "error", "--parent", str(os.getpid()))
AT_ONCE = 4
"""So many of those who drive may be starting at a time."""
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


class Running:
    """``python -m …``, a child that says JSON lines, and is gone at the end."""

    def __init__(self, arguments: list[str], log: IO[str]) -> None:
        ready_to_start()
        self.process = psutil.Popen(
            [sys.executable, "-m", *arguments],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True,
        )  # fmt: skip
        self._log = log

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def wait_for(self, event: str) -> dict[str, Any]:
        """The next event, which must be this one."""
        out: IO[str] = self.process.stdout
        line = json.loads(out.readline() or '{"event": "nothing"}')
        if line["event"] != event:
            wrote = Path(self._log.name).read_text()[-2000:]
            raise RuntimeError(f"waited for {event!r}, was told {line['event']!r}; all wrote: {wrote}")
        return dict(line)


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
        leader = ["leader", str(self._file), "-l", leader_end, *QUIET]
        with ExitStack() as stack:
            log = stack.enter_context(self._log.open("w"))

            def started(arguments: list[str]) -> Running:
                return stack.enter_context(Running(arguments, log))

            bodies = started(["tests.campaigns.bench.bodies", json.dumps(plan)])
            bodies.wait_for("ready")
            others = {"bodies": bodies.process, "leader": started(leader).process}
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
        """Start whoever drives, a few at a time: who starves gives up its links, and makes them anew."""
        running: dict[str, Running] = {}
        starting: deque[Running] = deque()
        for name, argv in self._argv().items():
            running[name] = start(argv)
            starting.append(running[name])
            if len(starting) == AT_ONCE:
                starting.popleft().wait_for("ready")
        return {name: one.process for name, one in running.items()}

    def _argv(self) -> dict[str, list[str]]:
        """What ``python -m`` is given for each that drives."""
        if self._central:
            plan = {
                "mission": str(self._file),
                "dial": [self._ends[self._mission.leader], *self._robots.values()],
            }
            return {"central": ["tests.campaigns.bench.central", json.dumps(plan)]}
        return {name: self._agent(name) for name in self._mission.followers}

    def _agent(self, name: str) -> list[str]:
        dialled = [word for to in wiring.called(self._mission, name) for word in ("-e", self._ends[to])]
        return [
            "agent", str(self._file), "--robot", name, *QUIET,
            "--robot-connect", self._robots[name], "-l", self._ends[name], *dialled,
        ]  # fmt: skip
