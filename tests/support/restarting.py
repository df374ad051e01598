"""Agents of a fleet on the fake clock that die, and come back with what was kept of them, or without."""

from __future__ import annotations

import cmath
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from formation.agent.persistence.persistence import Persistence
from formation.agent.persistence.state import Json
from formation.control.tracker import FRESH_PERIODS
from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.ros2.messages import Twist, TwistStamped
from formation.ros2.messages import encode as encode_message
from formation.topics import CMD_VEL
from formation.wire import Now, Sample
from tests.support.missions import with_keys
from tests.support.recorded import Looped, RecordedFleet

SIX = load("six_robots")
BOOT = "this very boot"


@dataclass
class Drawer:
    """Stands in for the files of an agent: a `Store` that writes at once."""

    texts: dict[str, bytes] = field(default_factory=dict)
    stops: Path = Path("/somewhere/robot.stops.json")
    failure: str = ""

    stops_failed: bool = False

    def write_stops(self, stops: Json) -> None:
        self.stops_failed = self._write("stops", stops)

    def write_state(self, state: Json) -> None:
        self._write("state", state)

    def _write(self, name: str, value: Json) -> bool:
        """Write, unless that fails; whether it does."""
        if not self.failure:
            self.texts[name] = json.dumps(value, allow_nan=False).encode()
        return bool(self.failure)

    def written(self, _patience: float) -> bool:
        return not self.stops_failed

    def read_stops(self) -> bytes | None:
        return self.texts.get("stops")

    def read_state(self) -> bytes | None:
        return self.texts.get("state")

    def set_state_aside(self) -> Path | None:
        self.texts.pop("state", None)
        return Path("/somewhere/robot.state.failed")

    def change(self, name: str, **values: Any) -> None:
        """Have another value stand in what was kept."""
        self.texts[name] = json.dumps({**json.loads(self.texts[name]), **values}).encode()


@dataclass
class Team(RecordedFleet):
    """A fleet whose agents keep things, and whose robots have watchdogs."""

    drawers: dict[str, Drawer] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.mission.followers:
            self.drawers[name] = Drawer()
            self.begin(name)

    def begin(self, name: str, *, empty: bool = False, boot: str = BOOT) -> None:
        """Start an agent's process with what it finds in its drawer, or with none at all."""
        self.agents[name] = self.new_agent(name)
        store: Any = self.drawers[name]
        persistence = None if empty else Persistence(self.agents[name], store, boot)
        looped = Looped(self.agents[name], self.record, persistence=persistence, clock=self.read_clock)
        looped.sides.begin(self.moment)
        self.nodes[name].core = looped
        self.revive(name)

    def read_clock(self) -> Now:
        """The clock of the agents' loops, as a method, so that a copied team has its own."""
        return self.moment

    def lose(self, name: str, seconds: float) -> None:
        """Kill an agent; its watchdog tells the robot to stand after 3 periods of silence."""
        spec = self.mission.robots[name]
        self.kill(name)
        silence = (FRESH_PERIODS + 1.0) / spec.rate
        self.run(min(seconds, silence))
        if seconds >= silence:
            zero = TwistStamped(0.0, 0.0, 0.0) if spec.cmd_vel == "twist_stamped" else Twist(0.0, 0.0)
            self._deliver("world", Sample(CMD_VEL.key(name), encode_message(zero), None, self.now + 0.0005))
            self.run(seconds - silence)

    def replace(self, name: str, seconds: float = 1.0, *, empty: bool = False, boot: str = BOOT) -> None:
        """Lose an agent for so long, and start the next."""
        self.lose(name, seconds)
        self.begin(name, empty=empty, boot=boot)

    def heading_error(self, name: str) -> float:
        """How far an agent's heading is off its robot's, now [deg]."""
        self.points()  # brings the world up to now
        here = self.agents[name].here
        return math.degrees(abs(cmath.phase(here.heading / self.world.plant(name).heading)))


def turning_back(name: str = "six_robots", after: float = 12.0, **keys: str | float) -> Mission:
    """A shipped mission whose leader turns by 130 degrees; with these keys in its [robot] table."""
    head, _, tail = read(name)[0].partition("[[route]]")
    _, table, rest = tail.partition("[simulation]")
    legs = "[[route]]\nspeed = 0.2\nheading_deg = {}\nduration = {}\n\n"
    text = f"{head}{legs.format(30, after)}{legs.format(160, 1e4)}{table}{rest}"
    return parse(with_keys(text, **keys))


def driving(mission: Mission = SIX, seconds: float = 8.0) -> Team:
    """A team that has driven for so long."""
    return Team.under_way(mission, seconds)
