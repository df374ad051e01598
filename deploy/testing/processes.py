"""Every process of a mission on this machine, over real Zenoh, driven by a test."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import Any

from formation.agent.simulated.faults import parse
from formation.deploy.local.launch import Child, Launcher
from formation.deploy.local.plan import Program, leaders, programs
from formation.deploy.local.ports import Ports
from formation.deploy.terminal.snapshot import NOTHING_KNOWN, RobotNow, Snapshot
from formation.deploy.testing.fleet import DrivenFleet, check_name, group, mission_of, several
from formation.deploy.testing.relays import HOST, Relays
from formation.monitor.metrics.event import Event
from formation.protocol.outcome import Outcome
from formation.stability import intent
from formation.transport import asking, wiring
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig

START_TIMEOUT_SECONDS = 120.0
"""Time for all processes to get ready [s]; a second on an idle machine."""
ORDER_TIMEOUT_SECONDS = 5.0
"""Wait for the answers to an order [s]."""
PAUSE = 0.1
"""Longest wait for one message of the processes [s]."""


class ProcessFleet(DrivenFleet):
    """All processes of `mission` on this machine: simulated robots, agents, leader, standbys and a monitor.

    `mission` is a file, the name of a shipped mission, or the text of one. What the methods tell is what the
    monitor knows, five times a second. `faults` are those of ``formation run --fault``. `drivers` are
    commands that play robots instead of a simulated one, such as ``{"robot2": ["python3", "driver.py",
    "{endpoint}"]}``: each listens as the robot's own Zenoh router at that endpoint. The recording and
    the logs go to `folder`.

    Raises ValueError for what is not legal, AssertionError if a process does not get ready.
    """

    def __init__(
        self,
        mission: str | Path,
        *,
        law: str | None = None,
        faults: Sequence[str] = (),
        watchdogs: bool = False,
        drivers: Mapping[str, Sequence[str]] | None = None,
        folder: Path | None = None,
    ) -> None:
        self.mission = mission_of(mission, law)
        self.snapshot = NOTHING_KNOWN
        """The newest one of the monitor."""
        self.events: list[Event] = []
        """All events of the monitor."""
        drivers = drivers or {}
        for name in drivers:
            if name not in self.mission.followers:
                raise ValueError(f"drivers: {name}: must be one of {', '.join(self.mission.followers)}")
        for text in several(faults):
            check_name(parse(text, self.mission).robot, self.mission.followers)
        self._held, self._closed = ExitStack(), False
        self._frozen: set[str] = set()  # names of processes
        self._cuts: set[tuple[str, str]] = set()
        try:
            self.folder = folder or Path(self._held.enter_context(tempfile.TemporaryDirectory()))
            self.folder.mkdir(parents=True, exist_ok=True)
            ports = self._held.enter_context(Ports(self.mission))
            self._agents = dict(ports.endpoints.agents)
            self._relays = Relays()
            self._held.callback(self._relays.close)
            self._launcher = self._held.enter_context(Launcher(self.folder))
            self._programs = {
                one.name: one
                for one in programs(
                    self.mission,
                    self._source(mission),
                    ports.endpoints,
                    parent=os.getpid(),
                    record=self.folder / "recording.mcap",
                    law=law,
                    watchdogs=watchdogs,
                    page=("--no-page",),
                    world=[word for fault in several(faults) for word in ("--fault", fault)],
                    patience=START_TIMEOUT_SECONDS,
                    simulated=[name for name in self.mission.followers if drivers and name not in drivers],
                )
            }
            self._drive(drivers, ports.endpoints.robots)
            self._relay()
            for program in self._programs.values():
                self._launcher.start(program)
            self._wait_until_ready()
        except BaseException:
            self._held.close()
            raise

    @property
    def leader(self) -> str | None:
        """Name of the candidate that leads, if the monitor knows one."""
        return self.snapshot.leads

    @property
    def recording(self) -> Path:
        """The monitor's recording; complete after `close`."""
        return self.folder / "recording.mcap"

    def run(self, seconds: float) -> None:
        """Let the fleet run. Raises AssertionError if a process ends that was not killed."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._look(min(left, PAUSE))

    def error(self) -> float:
        """Return the formation error, summed over all edges [m]; NaN while a position is missing."""
        return self.snapshot.error

    def state(self, robot: str) -> str:
        """Return the state of a follower's agent, such as ``run`` or ``hold``; empty if it is unknown."""
        return self.snapshot.robots.get(robot, RobotNow()).state

    def kill(self, name: str) -> None:
        """Kill the agent of a follower, or a candidate, with SIGKILL."""
        self._child(name).kill()

    def start(self, name: str) -> None:
        """Start it again, and wait until it is ready."""
        process = self._process(name)
        self._launcher.start(self._programs[process])
        self._frozen.discard(process)
        self._wait_until_ready()

    def freeze(self, name: str) -> None:
        """Suspend it with SIGSTOP."""
        self._frozen.add(self._process(name))
        os.kill(self._child(name).pid, signal.SIGSTOP)

    def thaw(self, name: str) -> None:
        """Let it continue."""
        self._frozen.discard(self._process(name))
        os.kill(self._child(name).pid, signal.SIGCONT)

    def cut(self, some: Iterable[str], others: Iterable[str]) -> None:
        """Cut the links between two groups of robots, leader and standbys, until `heal`.

        What is sent meanwhile waits, and arrives then. Raises ValueError for an unknown name.
        """
        known = wiring.members(self.mission)
        pairs = set(product(group(some, known), group(others, known)))
        self._cuts |= pairs
        self._relays.cut(pairs, is_cut=True)

    def heal(self) -> None:
        """Mend all links."""
        self._relays.cut(self._cuts, is_cut=False)
        self._cuts.clear()

    def order(self, order: str, **what: Any) -> Outcome:
        """Order as an operator does, such as ``order("rotate", degrees=30)``; wait until all have answered.

        Raises ValueError for an order that is not legal.
        """
        request = intent.request_for(self.mission, order, **what)
        recipients = asking.addressed(self.mission, request.do)
        dialled = tuple(self._agents[name] for name in recipients.names)
        config = BusConfig(connect=dialled, namespace=self.mission.team or "", name=asking.OPERATOR)
        with Bus(config) as bus:
            return asking.give(
                bus.question, recipients, request, ORDER_TIMEOUT_SECONDS, linked=lambda: bus.links
            )

    def close(self) -> None:
        """End all processes; a second call has no effect."""
        if self._closed:
            return
        self._closed = True
        for process in self._frozen:
            os.kill(self._newest(process).pid, signal.SIGCONT)
        self._frozen.clear()
        self.heal()
        self._held.close()

    def _time(self) -> float:
        return time.monotonic()

    def _step(self) -> None:
        self._look(PAUSE)

    def _source(self, mission: str | Path) -> str:
        if "\n" not in str(mission):
            return str(mission)
        file = self.folder / "mission.toml"
        file.write_text(str(mission))
        return str(file)

    def _drive(self, drivers: Mapping[str, Sequence[str]], robots: Mapping[str, str]) -> None:
        """Start `drivers` in place of simulated robots."""
        if drivers.keys() == set(self.mission.followers):
            del self._programs["robots"]
        for name, command in drivers.items():
            argv = tuple(word.format(endpoint=robots[name]) for word in command)
            self._programs[f"driver {name}"] = Program(f"driver {name}", "body", argv, (name,))

    def _relay(self) -> None:
        """Have agents and candidates dial each other through relays."""
        names = {endpoint: name for name, endpoint in self._agents.items()}
        for name in wiring.members(self.mission):
            process = self._process(name)
            program, argv = self._programs[process], []
            for before, word in zip(("", *self._programs[process].argv), program.argv, strict=False):
                other = names.get(word) if before == "-e" else None
                port = other and self._relays.add(name, other, int(word.rpartition(":")[2]))
                argv.append(f"tcp/{HOST}:{port}" if port else word)
            self._programs[process] = program._replace(argv=tuple(argv))

    def _look(self, timeout: float) -> None:
        """Take in one message of the processes. Raises AssertionError if one has ended by itself."""
        event = self._launcher.next_event(timeout)
        if event is not None and event.data["event"] == "snapshot":
            self.snapshot = Snapshot.of(event.data)
            self.events += self.snapshot.events
        if self._launcher.interrupted:
            raise KeyboardInterrupt
        for child in self._launcher.children:
            if child.died:
                raise AssertionError(f"{child.name} ended, exit code {child.exit}: {_last(child)}")

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT_SECONDS
        while late := [one for one in self._launcher.children if not self._is_ready(one)]:
            self._look(PAUSE)
            if time.monotonic() > deadline:
                raise AssertionError(
                    f"{late[0].name} was not ready within {START_TIMEOUT_SECONDS:g} s: {_last(late[0])}"
                )

    def _is_ready(self, child: Child) -> bool:
        return child.ready or child.end_requested or child.name.startswith("driver ")

    def _process(self, name: str) -> str:
        """Return the name of the process of a robot or candidate. Raises ValueError."""
        candidates = leaders(self.mission)
        check_name(name, wiring.members(self.mission))
        return candidates.get(name, f"agent {name}")

    def _child(self, name: str) -> Child:
        return self._newest(self._process(name))

    def _newest(self, process: str) -> Child:
        return next(one for one in reversed(self._launcher.children) if one.name == process)


def _last(child: Child) -> str:
    return " | ".join(child.last_log_lines()) or "it said nothing"
