"""A team in a field under mTLS and access control, with a witness of the victim's commands and an attacker.

Each robot is a computer of its own, with its agent, and the simulated robot on its loopback. `robot1` and
`robot2` measure the leader; `robot2` also measures `robot1`, and is the victim. `robot3`, which measures
`robot2`, is absent: the attacker has its key.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from formation.deploy.fleet import authority, certificates
from formation.mission.file import parse
from formation.mission.model import Mission
from tests.field.sessions import Desk, prepared
from tests.support.namespaces import Computer, Field, Running, until

VICTIM = "robot2"
TEXT = """
name = "attacked"
leader = "leader"
team = "reds"

[law]
k_p = 2.0
k_i = 0.5

[robot]
control_point_offset = 0.1
max_speed = 0.6
max_turn_rate = 2.0
rate = 20
robot_endpoint = "tcp/127.0.0.1:7447"

[shapes.row]
robot1 = [-0.4, 0.3]
robot2 = [-0.6, -0.3]
robot3 = [-1.0, 0.0]

[robots.leader]
endpoint = "tls/10.77.0.1:7460"
start = { x = 0.0, y = 0.0 }

[robots.robot1]
endpoint = "tls/10.77.0.2:7460"
neighbours = ["leader"]
start = { x = -0.6, y = 0.35, heading_deg = 0 }

[robots.robot2]
endpoint = "tls/10.77.0.3:7460"
neighbours = ["leader", "robot1"]
start = { x = -0.8, y = -0.35, heading_deg = 0 }

[robots.robot3]
endpoint = "tls/10.77.0.4:7460"
neighbours = ["robot2"]
start = { x = -1.1, y = 0.0, heading_deg = 0 }

[[route]]
speed = 0.1
heading_deg = 0
"""


class Command(NamedTuple):
    """One command that the victim's robot received."""

    at: float
    """[s, monotonic]"""
    speed: float
    """[m/s]"""
    turn_rate: float
    """[rad/s]"""


class Band(NamedTuple):
    """Range of commands without an attack, with a margin."""

    speed: tuple[float, float]
    turn_rate: tuple[float, float]

    def holds(self, command: Command) -> bool:
        """Whether a command is within the range."""
        return (
            self.speed[0] <= command.speed <= self.speed[1]
            and self.turn_rate[0] <= command.turn_rate <= self.turn_rate[1]
        )

    @classmethod
    def of(cls, commands: list[Command]) -> Band:
        """Twice the range of `commands`, plus what a formation error of 2 mm commands."""
        return cls(
            _around([command.speed for command in commands], 0.004),
            _around([command.turn_rate for command in commands], 0.04),
        )


def _around(values: list[float], margin: float) -> tuple[float, float]:
    middle = median(values)
    reach = 2.0 * max(abs(value - middle) for value in values) + margin
    return middle - reach, middle + reach


class Team:
    """The running team, with commands and status of the victim."""

    def __init__(self, field: Field, desk: Desk, source: Path) -> None:
        self.field, self.desk, self.source = field, desk, source
        names = ("leader", "robot1", "robot2", "attacker", "desk")  # addresses as in the mission
        self.computers = {name: field.computer(name) for name in names}
        self.running: dict[str, Running] = {}

    @property
    def attacker(self) -> Computer:
        """The attacker's computer."""
        return self.computers["attacker"]

    @property
    def desk_computer(self) -> Computer:
        """The operator's computer."""
        return self.computers["desk"]

    def start(self) -> None:
        """Start all processes but the attacker's, and wait until they are ready."""
        for name in ("robot1", "robot2"):
            here = self.computers[name]
            self.running[f"{name}'s body"] = here.start(*self.formation("robot", "--robot", name))
        self.running["witness"] = self.computers[VICTIM].start(
            sys.executable, "-m", "tests.field.witness", "tcp/127.0.0.1:7447", VICTIM
        )
        self.running["attacker"] = self.start_attacker()
        for name in ("leader", "robot1", "robot2"):
            self.start_process(name)
        for name in ("leader", "robot1", "robot2"):
            self.running[name].event("ready")

    def start_process(self, name: str) -> None:
        """Start the leader or the agent of a robot."""
        part = ("leader",) if name == "leader" else ("agent", "--robot", name)
        self.running[name] = self.computers[name].start(
            *self.formation(*part, "-c", str(self.desk.file(name)))
        )

    def start_attacker(self) -> Running:
        """Start a process that runs the attacks it is told."""
        return self.attacker.start(sys.executable, "-m", "tests.field.attacker", stdin=subprocess.PIPE)

    def formation(self, command: str, *flags: str) -> tuple[str, ...]:
        """A command line of `formation` for this mission."""
        return (sys.executable, "-m", "formation.deploy", command, str(self.source), *flags)

    def attack(self, kind: str, **how: Any) -> Any:
        """Run an attack to its end; return the result that the attacker reports."""
        attacker = self.running["attacker"]
        before = len(attacker.events("done"))
        attacker.tell(attack(kind, **how))
        until(lambda: len(attacker.events("done")) > before or attacker.ended, what=f"the end of {kind}")
        assert not attacker.ended, attacker.errors
        return attacker.events("done")[-1]["result"]

    def commands(self, since: float = 0.0, before: float = float("inf")) -> list[Command]:
        """Commands that the victim's robot received between two times [s, monotonic]."""
        found = [
            Command(result["at"], result["speed"], result["turn_rate"])
            for result in self.running["witness"].events("command")
        ]
        return [command for command in found if since <= command.at < before]

    def status(self) -> dict[str, str]:
        """The newest status of the victim."""
        result = self.running["witness"].events("status")
        values: dict[str, str] = result[-1]["values"] if result else {}
        return values

    def states(self, since: float) -> set[str]:
        """States in the victim's statuses since a time [s, monotonic]."""
        return {
            result["values"]["state"]
            for result in self.running["witness"].events("status")
            if result["at"] >= since
        }

    def refused(self) -> dict[str, int]:
        """Number of refusals by kind, from the victim's status."""
        values = self.status()
        return {
            name.removeprefix("refused."): int(value)
            for name, value in values.items()
            if name.startswith("refused.")
        }

    def dropped(self) -> dict[str, tuple[int, str]]:
        """Messages that the victim's agent dropped, by key: number and last reason."""
        values = self.status()
        counts = {
            name.removeprefix("dropped."): int(value)
            for name, value in values.items()
            if name.startswith("dropped.")
        }
        return {key: (count, values[f"dropped_last.{key}"]) for key, count in counts.items()}

    def settled(self) -> bool:
        """Whether the victim has driven straight and settled for two seconds."""
        last = self.commands()[-40:]
        return len(last) == 40 and all(
            abs(one.speed - 0.1) < 0.005 and abs(one.turn_rate) < 0.05 for one in last
        )


def attack(kind: str, **how: Any) -> str:
    """The line that tells an attacker what to do."""
    return json.dumps({"kind": kind, "how": how})


def longest_gap(commands: list[Command]) -> float:
    """Longest time between two successive commands [s]."""
    return max(later.at - earlier.at for earlier, later in pairwise(commands))


def mission() -> Mission:
    return parse(TEXT, "attacked.toml")


@contextmanager
def driving(folder: Path) -> Iterator[Team]:
    """A team that drives settled."""
    source = folder / "attacked.toml"
    source.write_text(TEXT, encoding="utf-8")
    with Field() as field:
        team = Team(field, prepared(mission(), folder / "secrets"), source)
        team.start()
        until(team.settled, 60.0, "the victim drives straight")
        yield team


def issued(
    desk: Desk, folder: Path, name: str, *, begins: timedelta = timedelta(), seconds: float = 3600.0
) -> Path:
    """Put a certificate of the team's authority into `folder`, valid from `begins` on for `seconds`."""
    address = mission().robots[name].endpoint or ""
    pair = authority.issue(
        certificates.read_authority(desk.folder),
        name,
        address.removeprefix("tls/").partition(":")[0],
        seconds / 86400.0,
        datetime.now(UTC) + begins,
    )
    folder.mkdir(exist_ok=True)
    (folder / certificates.KEY).write_bytes(pair.key_pem)
    (folder / certificates.CERTIFICATE).write_bytes(pair.certificate_pem)
    return folder
