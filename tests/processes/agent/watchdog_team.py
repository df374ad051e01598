"""A team whose robots have watchdogs, and the ways in which agents are lost: what bar and tests share.

Five followers, each measuring the leader and nobody else, so that one robot's stop is no other's doubt.
Bodies are ideal: without lag the wheels are at exactly zero as soon as they are told to be.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, Protocol

from formation.mission.file import load
from formation.mission.model import Mission
from formation.transport.wiring import Endpoints
from tests.processes.agent.wheels import Moving, Said, Wheels

ROBOTS = ("robot2", "robot3", "robot4", "robot5", "robot6")
WITHIN = 0.3
"""The bar: a robot that lost its agent stands after so long [s]."""
ROUNDS = 4
"""Each robot loses its agent so often: 20 tries in all."""
NICE = {
    "formation.agent": -5,
    "formation.agent.watchdog": -15,
    "formation.leader": -20,
    "formation.agent.simulated": -20,
    "tests.processes.agent.wheels": -20,
}
"""Priorities by module: those of the units; everybody else has a computer of its own."""
PERIOD = 0.05
MAX_SPEED, MAX_TURN_RATE = 0.5, 1.5
LEADER_SPEED, RAMP = 0.2, 0.25
LEFT_BEHIND = LEADER_SPEED**2 / (2.0 * MAX_SPEED / RAMP)
"""How far a robot's place moves on while its commands ramp up to the leader's speed [m]."""
STALL = 2.0 * PERIOD
"""A longer gap in the odometry means that this machine had other things to do [s]."""
AFTERMATH = 0.3
"""So long after such a gap a healthy robot may stand [s]: its agent held, and its commands ramp up."""
_MISSION = f"""\
name = "watchdogs"
leader = "robot1"

[robot]
control_point_offset = 0.1
max_speed = {MAX_SPEED}
max_turn_rate = {MAX_TURN_RATE}
rate = 20

[shapes.line]
{{slots}}

[robots.robot1]
start = {{{{ x = 0.0, y = 0.0 }}}}
endpoint = "{{leader}}"

{{robots}}
[[route]]
speed = 0.2
heading_deg = 0
"""
_ROBOT = """\
[robots.{name}]
neighbours = ["robot1"]
start = {{ x = -0.1, y = {y} }}
cmd_vel = "{kind}"
endpoint = "{agent}"
robot_endpoint = "{robot}"
"""


class Runs(Protocol):
    """A process that was started, wherever that is."""

    @property
    def pid(self) -> int:
        """Its id."""

    @property
    def errors(self) -> str:
        """What it wrote to stderr."""

    def event(self, name: str) -> Mapping[str, Any]:
        """Wait until it says so."""


Start = Callable[[str, str, list[str]], Runs]
"""Starts a process: what it is called (a robot's name for its agent), its module, its arguments."""


def write_mission(path: Path, where: Endpoints) -> Mission:
    """A mission of robots that take either type of command."""
    slots = "\n".join(f"{name} = [0.0, {i}.0]" for i, name in enumerate(ROBOTS, 1))
    robots = "\n".join(
        _ROBOT.format(
            name=name,
            y=f"{i}.0",
            kind=("twist", "twist_stamped")[i % 2],
            agent=where.agents[name],
            robot=where.robots[name],
        )
        for i, name in enumerate(ROBOTS, 1)
    )
    text = _MISSION.format(slots=slots, robots=robots, leader=where.agents["robot1"])
    path.write_text(text, encoding="utf-8")
    return load(path)


class Team:
    """Leader, simulated robots, their watchdogs, an observer, and agents that may be lost and found."""

    def __init__(self, start: Start, folder: Path, where: Endpoints) -> None:
        """`start` starts each process where it belongs."""
        self._start = start
        self._file = folder / "mission.toml"
        self.mission = write_mission(self._file, where)
        self.agents: dict[str, Runs] = {}
        robots = start("robots", "formation.agent.simulated", [str(self._file)])
        robots.event("ready")
        self.leader = start("leader", "formation.leader", [str(self._file)])
        self.watchdogs = {
            name: start("watchdog", "formation.agent.watchdog", [str(self._file), "--robot", name])
            for name in ROBOTS
        }
        notes = folder / "notes"
        observer = start("observer", "tests.processes.agent.wheels", [str(self._file), str(notes)])
        for process in (self.leader, *self.watchdogs.values(), observer):
            process.event("ready")
        self.wheels = Wheels(self.mission, notes)

    def start(self, *names: str, flags: Mapping[str, list[str]] | None = None) -> None:
        """Start agents and wait until they drive in formation. `flags` are an agent's own."""
        for name in names:
            more = (flags or {}).get(name, [])
            self.agents[name] = self._start(
                name, "formation.agent", [str(self._file), "--robot", name, *more]
            )
        for name in names:
            self.agents[name].event("ready")
        self.settle(*names)

    def settle(self, *names: str) -> None:
        """Wait until these robots drive in formation."""
        for name in names:
            try:
                self.wheels.until(partial(self.wheels.drives, name), f"{name} drives in formation")
            except AssertionError as error:
                error.add_note(f"{self.wheels.about(name)}\n{self.agents[name].errors}")
                raise


def tries(team: Team, lose: Callable[[str], None], find: Callable[..., None]) -> list[float]:
    """``lose(name)`` each robot's agent in turn, then ``find(*names)`` them all again, `ROUNDS` times.

    Returns how long after the loss each robot stood, by its own odometry [s]. Checks that it stays where it
    stands, and that what it is told once its agent is back is within limits and leads to its place, directly.
    """
    took, phase = [], random.Random(0)
    for _ in range(ROUNDS):
        for name in ROBOTS:
            time.sleep(phase.uniform(0.0, PERIOD))  # anywhere between two commands
            team.settle(name)  # it may have been held up by a machine that had other things to do
            lost = time.time()
            lose(name)
            team.wheels.until(partial(team.wheels.stands, name, lost), f"{name} stands")
            took.append(team.wheels.stood(name, lost) - lost)
        found = time.time()
        find(*ROBOTS)
        team.settle(*ROBOTS)
        for name in ROBOTS:
            resumed_without_a_lurch(team.wheels, name, found)
    return took


def resumed_without_a_lurch(wheels: Wheels, name: str, found: float) -> None:
    """What a robot was told since its agent is back is within limits, and leads to its place, directly.

    Its place moves on without it while its commands ramp up, and while it is told to stand once more.
    """
    commands = wheels.commanded(name, found, time.time())
    assert all(abs(one.speed) <= MAX_SPEED and abs(one.turn_rate) <= MAX_TURN_RATE for one in commands)
    since = next(number for number, one in enumerate(commands) if moves(one))
    drove = commands[since].arrived
    errors = [error for stamp, error in wheels.errors[name] if stamp >= drove + PERIOD]
    left = left_behind(commands[since:])
    assert max(errors) <= errors[0] + 0.01 + left, f"{name} went astray, left behind {left:.3f} m: {errors}"


def left_behind(commands: Sequence[Said]) -> float:
    """How far a robot's place moves on without it [m] while it is told to stand, and at each new start."""
    held = [(before, after) for before, after in pairwise(commands) if not moves(before)]
    starts = 1 + sum(moves(after) for _, after in held)
    return LEADER_SPEED * sum(after.arrived - before.arrived for before, after in held) + starts * LEFT_BEHIND


def moves(command: Said) -> bool:
    """Whether it is not to stand."""
    return bool(command.speed or command.turn_rate)


def unstalled(moving: Sequence[Moving]) -> list[Moving]:
    """Odometry without what may come of a machine that stalled: what follows right after a gap in it.

    Robots say it with a priority above that of any agent, so that no agent's trouble makes such a gap.
    """
    good, since = list(moving[:1]), float("-inf")
    for before, one in pairwise(moving):
        since = one.stamp if one.stamp - before.stamp > STALL else since
        good += [one] * (one.stamp > since + AFTERMATH)
    return good


def summary_of(kind: str, took: list[float]) -> str:
    """A line to quote."""
    within = sum(one <= WITHIN for one in took)
    return (
        f"{kind}: {within} of {len(took)} within {WITHIN:g} s; median {median(took):.3f} s, worst"
        f" {max(took):.3f} s; all: {' '.join(f'{one:.3f}' for one in took)}"
    )
