"""A mission deployed as by a user: certificates, bundles, and install.sh for each robot."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

from formation.deploy.fleet import bundle, certificates
from formation.deploy.fleet.wheels import Target
from formation.mission.file import DESK, parse
from formation.mission.model import Mission
from tests.support.namespaces import Computer, Field, Running

HERE = Target(os.uname().machine, f"{sys.version_info.major}.{sys.version_info.minor}")
"""This machine, as a bundle names it."""
TEXT = """
# A leader, a follower, and a follower of the follower; addresses are those of a `Field`, in this order.
name = "three-in-a-row"
leader = "leader"
duration = 60

[law]
k_p = 2.0
k_i = 0.2

[robot]
control_point_offset = 0.05
max_speed = 0.2108
max_turn_rate = 2.635
radius = 0.105
rate = 20
cmd_vel = "twist_stamped"
robot_endpoint = "tcp/127.0.0.1:7447"

[shapes.row]
robot1 = [-0.4, 0.25]
robot2 = [-0.8, 0.0]

[robots.leader]
endpoint = "tls/10.77.0.1:7460"
start = { x = 0.0, y = 0.0 }

[robots.robot1]
endpoint = "tls/10.77.0.2:7460"
neighbours = ["leader"]
start = { x = -0.6, y = 0.45, heading_deg = 0 }

[robots.robot2]
endpoint = "tls/10.77.0.3:7460"
neighbours = ["robot1"]
start = { x = -1.1, y = -0.1, heading_deg = 30 }

[[route]]
speed = 0.05
heading_deg = 0
"""


def commands(unit: str, state: str = "%S") -> list[list[str]]:
    """Command lines of a unit in order, with its own variables replaced; `state` is systemd's %S."""
    variables = dict(re.findall(r"(?m)^Environment=(\w+)=(.*)$", unit))
    lines = re.findall(r"(?m)^Exec(?:Start|StopPost)=(.*)$", unit.replace("%S", state))
    return [re.sub(r"\$(\w+)", lambda word: variables[word[1]], line).split() for line in lines]


def mission() -> Mission:
    return parse(TEXT, "three.toml")


def secrets(folder: Path) -> Path:
    """Make certificates for all processes of the mission; return their folder."""
    now = datetime.now(UTC)
    certificates.create(mission(), folder, days=1.0, authority_days=1.0, now=now)
    return folder


def bundles(folder: Path) -> Path:
    """Make bundles with all wheels for this machine; return their folder."""
    now = datetime.now(UTC)
    out = folder / "bundles"
    bundle.make(mission(), TEXT, out, secrets(folder / "secrets"), HERE, now=now)
    return out


def install(robot: Path, prefix: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Run a robot's install.sh with an environment of only PATH and pip's settings."""
    command = ["sh", str(robot / "install.sh"), "--prefix", str(prefix), *flags]
    variables = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    variables["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return subprocess.run(command, env=variables, capture_output=True, text=True, timeout=250, check=False)


class Installed:
    """Prefixes in which robots' bundles are installed, each when it is first asked for."""

    def __init__(self, out: Path, folder: Path) -> None:
        self._out, self._folder = out, folder

    def prefixes(self, *names: str) -> dict[str, Path]:
        """Prefixes by robot; what is in them must not be changed."""
        found = {name: self._folder / name for name in names}
        missing = [name for name, prefix in found.items() if not prefix.exists()]
        with ThreadPoolExecutor() as pool:
            for done in pool.map(self._install, missing):
                assert done.returncode == 0, done.stderr
        return found

    def _install(self, name: str) -> subprocess.CompletedProcess[str]:
        return install(self._out / name, self._folder / name, "--no-systemd")


class Deployed:
    """A field in which every robot's bundle is installed, under a prefix of its own."""

    def __init__(self, field: Field, out: Path, installed: Installed, states: Path) -> None:
        self.field, self.out, self.mission, self._states = field, out, mission(), states
        states.mkdir()
        self.prefix = installed.prefixes(*self.mission.names)
        self.computers = {name: field.computer(name) for name in (*self.mission.names, DESK)}
        self.running: dict[tuple[str, str], Running] = {}
        """Running processes by computer and unit."""

    @property
    def desk(self) -> Computer:
        """The computer of monitor and operator."""
        return self.computers[DESK]

    def program(self, name: str) -> Path:
        """The installed `formation` of a robot."""
        return self.prefix[name] / "current" / "venv" / "bin" / "formation"

    def start_robot(self, name: str) -> Running:
        """Start the simulated robot on the loopback of its own computer."""
        source = self.prefix[name] / "current" / "mission.toml"
        robot = self.computers[name].start(self.program(name), "robot", source, "--robot", name)
        self.running[name, "robot"] = robot
        return robot

    def start_units(self, name: str) -> None:
        """Start the command lines of the robot's units."""
        for path in sorted((self.prefix[name] / "current" / "units").iterdir()):
            command = commands(path.read_text(encoding="utf-8"), str(self._states / name))[0]
            self.running[name, path.stem] = self.computers[name].start(*command)

    def start_monitor(self, recording: Path) -> Running:
        """Start the monitor at the desk with its own certificate."""
        desk = self.out / DESK
        flags = ("-c", desk / "monitor.json5", "--record", recording, "--snapshots")
        running = self.desk.start(sys.executable, "-m", "formation.monitor", desk / "mission.toml", *flags)
        self.running[DESK, "monitor"] = running
        return running

    def order(self, do: str, process: str = "operator") -> subprocess.CompletedProcess[str]:
        """Send an operator request from the desk, with the certificate of `process`."""
        desk = self.out / DESK
        seconds = "20" if process == "operator" else "3"  # the operator's ends as soon as all have replied
        flags = ("-c", desk / f"{process}.json5", "--json", "--timeout", seconds)
        return self.desk.run(
            sys.executable, "-m", "formation.deploy", "order", desk / "mission.toml", do, *flags
        )
