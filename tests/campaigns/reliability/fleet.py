"""A whole fleet of real processes in a field, each follower on its own computer, with a witness.

    computer      runs
    robot1        the leader
    robot2, …     agent, watchdog and simulated robot of each follower
    standbys      one each
    desk          the monitor, which records
    witness       nothing that is judged

Processes are called as the table of `formation run` calls them: ``agent robot2``, ``leader``, ``monitor``.
What systemd does on a robot, which is to start again what died, is done by whoever uses this.
"""

from __future__ import annotations

import json
import math
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from formation.mission.file import read
from formation.protocol.election import rank_of
from formation.transport import wiring
from formation.transport.wiring import Links
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.missions import FLEET, placed
from tests.campaigns.reliability.seen import Seen
from tests.support.namespaces import ASIDE, Computer, Field, Running, until

Words = Sequence[str | Path]
PATIENT = ("--cfg", "transport/unicast/max_links:2", "--cfg", "transport/link/tx/lease:10000")
"""Two links with the same peer, and none given up before it has been silent for 10 s."""
ANYWHERE = f"0.0.0.0:{FLEET}"


def beside(endpoint: str) -> str:
    """The same place by UDP, for what may be lost."""
    return f"udp/{endpoint.partition('/')[2]}?rel=0"


def module(name: str) -> tuple[str, ...]:
    """A Python that runs it."""
    return (sys.executable, "-m", name)


START = 120.0  # how long all processes together have to start, on a busy machine [s]
DESK, WITNESS = "desk", "witness"


class Fleet:
    """Everything of it, as a context manager."""

    def __init__(
        self,
        source: str,
        folder: Path,
        changes: Mapping[str, Any] | None = None,
        *,
        lossy: bool = False,
        without: Sequence[str] = (),
    ) -> None:
        """`source` is a mission's name or its text, `changes` replace some keys; files go to `folder`.

        Where links are `lossy`, each has one by UDP beside it, for what may be lost;
        `without` names kinds of processes that this fleet does not have, such as ``watchdog``.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._lossy = folder, lossy
        text = source if "\n" in source else read(source)[0]
        self.path, self.mission = placed(text, folder, changes)
        self._without = frozenset(without)
        self.followers = self.mission.followers
        self.field = Field(aside=True)
        self.running: dict[str, Running] = {}
        self.seen = Seen(self.mission)
        self.obeying: dict[str, float] = {}
        """When robots acknowledged a stop or a hold since the last `run` [s, monotonic]."""
        self.freed = math.inf
        """When all were last ordered to run [s, monotonic]."""
        self.wrong: list[str] = []
        """What went wrong while the present try was made."""
        self._recordings = 0
        self._parted = False

    @property
    def names(self) -> tuple[str, ...]:
        leads = ("leader", *(f"standby {name}" for name in self.mission.standbys))
        each = (f"{part} {name}" for name in self.followers for part in ("robot", "watchdog", "agent"))
        every = (*leads, *each, "monitor")
        return tuple(name for name in every if name.partition(" ")[0] not in self._without)

    def __enter__(self) -> Self:
        self.field.__enter__()
        try:
            for name in (*wiring.members(self.mission), DESK, WITNESS):
                self.field.computer(name)
        except BaseException:
            self.field.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.seen.close()
        self.field.close()

    def begin(self) -> None:
        """Start everybody, robots first, and wait until the witness sees all of them."""
        for name in sorted(self.names, key=lambda name: not name.startswith("robot")):
            self.start(name)
        file = self.folder / "seen.jsonl"
        fleet = [f"tcp/{self.aside(name)}:{FLEET}" for name in self.mission.candidates]
        robots = {name: f"tcp/{self.aside(name)}:7447" for name in self.followers}
        words = (json.dumps(fleet), json.dumps(robots))
        look = self.field.computers[WITNESS].start(
            *module("tests.campaigns.reliability.witness"), self.path, file, *words
        )
        for name in self.names:
            self.running[name].event("ready", START)
        look.event("ready", START)
        self.running[WITNESS] = look
        self.seen = Seen(self.mission, file)
        until(self._sees_all, START, "the witness sees every robot and the leader")

    def _command(self, process: str, path: Path) -> Words:
        """The command line of a process, as in the field, with clocks that can be set."""
        part, _, name = process.partition(" ")
        where = wiring.endpoints(self.mission)
        own: Words = ("--robot", name)
        match part:
            case "monitor":
                own = ("--record", self.recording, "--no-page", "--no-stage", "--snapshots")
                links = self._linked(Links((), tuple(where.agents.values())))
                return (*module("formation.monitor"), path, *own, *links)
            case "robot":
                clocked = self._clocked(name, "driver.clock", "formation.agent.simulated", path)
                return (*clocked, *own, "-l", "tcp/0.0.0.0:7447")
            case "watchdog":
                return (*self._clocked(name, "clock", "formation.agent.watchdog", path), *own)
        links = self._linked(wiring.of_member(self.mission, name or self.mission.leader, where))
        if part == "agent":
            state = ("--state", self.folder / "state" / name)
            return (*self._clocked(name, "clock", "formation.agent", path), *own, *state, *links)
        own = ("--standby", name) if part == "standby" else ()
        leads = name or self.mission.leader
        return (*self._clocked(leads, "clock", "formation.leader", path), *own, *links)

    def _clocked(self, robot: str, clock: str, runs: str, path: Path) -> Words:
        clocked = module("tests.campaigns.reliability.clocked")
        return (*clocked, self.folder / f"{robot}.{clock}", runs, path)

    def _linked(self, links: Links) -> list[str]:
        words: list[str] = []
        for place in (str, beside) if self._lossy else (str,):
            words += ["-l", place(f"tcp/{ANYWHERE}")] if links.listen else []
            words += [word for end in links.connect for word in ("-e", place(end))]
        return [*words, *PATIENT] if self._lossy else words

    def computer(self, process: str) -> Computer:
        owner = {"leader": self.mission.leader, "monitor": DESK}.get(process, process.rpartition(" ")[2])
        return self.field.computers[owner]

    def start(self, process: str, *flags: str, mission: Path | None = None) -> Running:
        """Start a process, for the first time or again, by its real command line, or with another mission."""
        self._recordings += process == "monitor"
        one = self.computer(process).start(*self._command(process, mission or self.path), *flags)
        self.running[process] = one
        return one

    def signal(self, process: str, number: int) -> None:
        """Send a signal to a process; whoever was killed by it is gone when this returns."""
        one = self.running[process]
        one.signal(number)
        if number == signal.SIGKILL:
            one.wait()

    def end(self, process: str) -> None:
        self.running[process].stop()

    def order(self, *words: str) -> tuple[int, dict[str, Any]]:
        """`formation order` at the desk: its exit code and its report."""
        own = ("--json", "--timeout", "3")
        command: Words = (*module("formation.deploy"), "order", self.path, *words, *own)
        try:
            done = self.field.computers[DESK].run(*command, timeout=33.0)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"order {' '.join(words)} did not come to its end") from None
        lines = done.stdout.splitlines()
        return done.returncode, json.loads(lines[-1]) if lines else {"error": done.stderr}

    def error(self, back: float = 0.0) -> float | None:
        """Formation error as late as it is known, if that is at most so long ago [m]."""
        self.seen.read_on()
        now = self.seen.now
        if not time.monotonic() - now <= back:
            return None
        return float(self.seen.errors(np.array([now]))[0])

    def settles(self, patience: float, since: float | None = None) -> bool:
        """Wait until the formation stands, `since` then [s, monotonic] or from now on; whether it does."""
        since = time.monotonic() if since is None else since
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline:
            time.sleep(0.1)
            self.seen.read_on()
            if (times := judge.grid(since, self.seen.now)).size and time.monotonic() - times[-1] < 1.0:
                errors = self.seen.errors(times)
                if judge.settled_at(times, errors) is not None and errors[-1] < judge.NEAR:
                    return True
        return False

    def part(self, others: Sequence[str]) -> None:
        """The air falls into two parts: `others` and the rest of them do not hear each other."""
        if not self._parted:
            self.field.access_point("beyond")
        self._parted = True
        for name in others:
            self.field.computers[name].roam("beyond")

    def heal(self) -> None:
        for name in wiring.members(self.mission):
            self.field.computers[name].roam()

    def set_clock(self, robot: str, off: float, *, driver: bool) -> None:
        """Set the clock of a leader, or of an agent, a watchdog and maybe a `driver`, so far off [s]."""
        for clock in ("clock", "driver.clock") if driver else ("clock",):
            (self.folder / f"{robot}.{clock}").write_text(str(off))

    def lose(self, share: float) -> None:
        """Of every packet that comes from the air to any computer, lose so many. Once in a fleet's life."""
        hook = "type filter hook input priority 0;"
        drop = f"numgen random mod 1000 < {round(1000 * share)} drop"
        for name in (*wiring.members(self.mission), DESK):
            computer = self.field.computers[name]
            computer.nft(f"add table inet loss; add chain inet loss in {{ {hook} }}")
            computer.nft(f"add rule inet loss in iifname eth0 {drop}")

    def delay(self, seconds: float) -> None:
        """Every packet takes so much longer from now on. Once in a fleet's life."""
        computers = [self.field.computers[name] for name in (*wiring.members(self.mission), DESK)]
        air = "tests.campaigns.reliability.air"
        for computer in computers:
            done = computer.run(*module(air), "unassisted", "eth0", timeout=START)
            assert done.returncode == 0, done.stderr
        switch, ports = self.field.take_over(computers)
        switch.start(*module(air), f"{seconds}", *ports).event("ready")

    def lost(self) -> Sequence[str]:
        """Processes that have ended though no test asked them to."""
        return [name for name, one in self.running.items() if one.ended]

    def save(self, folder: Path) -> None:
        """Keep what everybody said, for whoever wants to know why a try failed."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, one in self.running.items():
            (folder / f"{name.replace(' ', '-')}.log").write_text(one.output[-100_000:] + one.errors)
        for path in self.folder.glob("*.*"):
            shutil.copy(path, folder)

    @property
    def leading(self) -> str:
        """The process that leads at present, by its newest words."""
        self.seen.read_on()
        if not self.mission.standbys:
            return "leader"
        name = self.mission.candidates[rank_of(max(one.term for one in self.seen.leads[-40:]))]
        return "leader" if name == self.mission.leader else f"standby {name}"

    @property
    def recording(self) -> Path:
        return self.folder / f"recording{self._recordings}.mcap"

    @property
    def former_recording(self) -> Path:
        """The one before it, or the only one."""
        return self.folder / f"recording{max(1, self._recordings - (not self.running['monitor'].ended))}.mcap"

    def _sees_all(self) -> bool:
        self.seen.read_on()
        return self.seen.now > 0.0

    def aside(self, name: str) -> str:
        """Address of a computer on the network of whoever looks on."""
        return f"{ASIDE}.{self.field.computers[name].address.rpartition('.')[2]}"
