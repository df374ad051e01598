"""Damaged saved state whose checksum is right, given to an agent that starts.

An agent may refuse it and start fresh, or be stopped, but must neither fail nor move its robot where an agent
without saved state would not have moved it.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from formation.agent.core import Agent
from formation.agent.persistence.persistence import Persistence
from formation.mission.file import load
from formation.mission.model import Mission
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.topics import CMD_VEL
from formation.wire import Now, Outgoing, Sample
from tests.campaigns.fuzz.trying import Tried, attempt, changed, damaged
from tests.support.recorded import Looped
from tests.support.restarting import BOOT, Drawer, Team, turning_back

DRIVEN, GONE, AFTER = 4.0, 0.3, 1.0
"""How long the robot drives, its agent is gone, and the next one is watched [s]."""
Inbox = tuple[Now, list[Sample]]


class MovedError(AssertionError):
    """The robot was told to move, and should not have been."""


@dataclass
class Scene:
    """A robot whose agent died: what it left, and what the next one hears."""

    mission: Mission
    robot: str
    begun: Now
    texts: dict[str, bytes]
    received: list[Inbox] = field(default_factory=list)
    may_move: bool = True
    """Whether an agent without saved state moves the robot."""

    def start(self, texts: dict[str, bytes]) -> list[tuple[float, float]]:
        """Every command of an agent that finds `texts`. Raises what the agent does."""
        agent = Agent(self.mission, self.robot, publisher_id="fuzz")
        store: Any = Drawer(dict(texts))
        moment = [self.begun]
        looped = Looped(agent, [], persistence=Persistence(agent, store, BOOT), clock=lambda: moment[0])
        looped.sides.begin(self.begun)
        commands: list[tuple[float, float]] = []
        for now, inbox in self.received:
            moment[0] = now
            commands += self._commands(looped.step(now, inbox))
        looped.sides.end(moment[0])
        return commands

    def judge(self, texts: dict[str, bytes]) -> None:
        """Raise MovedError for a command that is not finite, or moves a robot that would stand."""
        for speed, turn_rate in self.start(texts):
            if not (math.isfinite(speed) and math.isfinite(turn_rate)):
                raise MovedError(f"told to go at {speed} m/s and {turn_rate} rad/s")
            if not self.may_move and (speed or turn_rate):
                raise MovedError(f"told to go at {speed:g} m/s and {turn_rate:g} rad/s, where it would stand")

    def _commands(self, outbox: Sequence[Outgoing]) -> Iterator[tuple[float, float]]:
        stamped = self.mission.robots[self.robot].cmd_vel == "twist_stamped"
        for out in outbox:
            if out.key == CMD_VEL.key(self.robot):
                twist = decode(TwistStamped, out.payload) if stamped else decode(Twist, out.payload)
                yield twist.speed, twist.turn_rate


def scenes() -> list[Scene]:
    """Robots that drive, hold or are stopped, with each source of positions."""
    variants: tuple[dict[str, Any], ...] = ({}, {"odometry_frame": "start"}, {"localisation": "external"})
    kinds = [*(turning_back(**one) for one in variants), load("posts")]
    found = [_scene(mission, ask) for mission in kinds for ask in ("", "hold")]
    return [*found, _scene(kinds[0], "", stopped=True)]


def _scene(mission: Mission, ask: str, *, stopped: bool = False) -> Scene:
    robot = mission.followers[2]
    team = Team(mission)
    team.run(DRIVEN)
    if ask:
        team.tell(mission.leader, ask)
        team.run(0.5)
    if stopped:
        team.tell(robot, "stop", id="a")
        team.run(0.5)
    team.lose(robot, GONE)
    scene = Scene(mission, robot, team.moment, dict(team.drawers[robot].texts))
    team.begin(robot, empty=True)
    core = team.loop(robot)
    step: Callable[[Now, Sequence[Sample]], list[Outgoing]] = core.step

    def noted(now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        scene.received.append((now, list(inbox)))
        return step(now, inbox)

    core.step = noted  # type: ignore[method-assign]
    team.run(AFTER)
    scene.may_move = any(speed or turn_rate for speed, turn_rate in scene.start({}))
    return scene


def form(scene: Scene, chance: random.Random) -> dict[str, bytes]:
    """What was kept, one of the files damaged."""
    texts = dict(scene.texts)
    name = chance.choice(("state", "state", "state", "stops")) if "stops" in texts else "state"
    if chance.random() < 0.2:
        texts[name] = damaged(texts[name], chance)
        return texts
    value = json.loads(texts[name])
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        value = changed(value, chance)
    texts[name] = json.dumps(value).encode()
    return texts


def tried(_folder: Path, seeds: range) -> Iterator[Tried]:
    """An agent started with the form of every seed."""
    found = scenes()
    for seed in seeds:
        chance = random.Random(seed)
        scene = chance.choice(found)
        texts = form(scene, chance)
        yield attempt("agent", seed, partial(scene.judge, texts), ())
