"""The command line of every process of a fleet in a field: as on a robot, but for certificates."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.wiring import Links
from tests.campaigns.reliability.placed import FLEET

Words = Sequence[str | Path]
PATIENT = ("--cfg", "transport/unicast/max_links:2", "--cfg", "transport/link/tx/lease:10000")
"""Two links with the same peer, and none given up before it has been silent for 10 s."""
ANYWHERE = f"0.0.0.0:{FLEET}"


class Commands:
    """Of one fleet."""

    def __init__(self, mission: Mission, path: Path, folder: Path, *, lossy: bool = False) -> None:
        """`path` is the mission's file, `folder` where processes keep theirs.

        Where links are `lossy`, each has one by UDP beside it, for what may be lost.
        """
        self._mission, self._path, self._folder, self._lossy = mission, path, folder, lossy

    def of(self, process: str, recording: Path) -> Words:
        """Of a process by its name, such as ``agent robot2``; the monitor's goes to `recording`."""
        part, _, name = process.partition(" ")
        mission, where = self._mission, wiring.endpoints(self._mission)
        match part:
            case "monitor":
                flags: Words = ("--record", recording, "--no-page", "--no-stage", "--snapshots")
                links = Links((), tuple(where.agents.values()))
                return (*module("formation.monitor"), self._path, *flags, *self._linked(links))
            case "robot":
                flags = ("--robot", name, "-l", "tcp/0.0.0.0:7447")
                return (
                    *self._clocked(self.driver_clock(name)),
                    "formation.agent.simulated",
                    self._path,
                    *flags,
                )
            case "watchdog":
                clock = self._clocked(self.clock(name))
                return (*clock, "formation.agent.watchdog", self._path, "--robot", name)
            case "agent":
                links = wiring.of_member(mission, name, where)
                flags = ("--robot", name, "--state", self._folder / "state" / name)
                clock = self._clocked(self.clock(name))
                return (*clock, "formation.agent", self._path, *flags, *self._linked(links))
            case _:
                own = ("--standby", name) if part == "standby" else ()
                links = wiring.of_member(mission, name or mission.leader, where)
                return (*module("formation.leader"), self._path, *own, *self._linked(links))

    def clock(self, robot: str) -> Path:
        """The file that says how far the clock of a robot's agent and watchdog is off [s]."""
        return self._folder / f"{robot}.clock"

    def driver_clock(self, robot: str) -> Path:
        """The same for the robot's driver."""
        return self._folder / f"{robot}.driver.clock"

    def _clocked(self, clock: Path) -> Words:
        return (*module("tests.campaigns.reliability.clocked"), clock)

    def _linked(self, links: Links) -> list[str]:
        words = ["-l", f"tcp/{ANYWHERE}"] if links.listen else []
        for end in links.connect:
            words += ["-e", end]
        if self._lossy:
            words += ["-l", beside(f"tcp/{ANYWHERE}")] if links.listen else []
            for end in links.connect:
                words += ["-e", beside(end)]
            words += PATIENT
        return words


def beside(endpoint: str) -> str:
    """The same place by UDP, for what may be lost."""
    return f"udp/{endpoint.partition('/')[2]}?rel=0"


def module(name: str) -> tuple[str, ...]:
    """A Python that runs it."""
    return (sys.executable, "-m", name)
