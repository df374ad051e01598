"""A whole fleet in one process: production cores on a fake clock over a lossy network in memory.

Nothing here knows the law. Each core is stepped as its loop would step it: at once when something arrives for
it, and by its timer when nothing does.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from agent.robots.simulated import World
from leader.core import Leader

from agent.core import Agent
from formation.graph import formation_error
from formation.messages import Diagnostics, Twist, TwistStamped, decode
from formation.mission import Mission
from formation.order import OperatorReply, OperatorRequest, encode
from formation.order import decode as decode_order
from formation.topics import CMD_VEL, ODOM, POSITION, STATUS
from formation.wire import Now, Outgoing, Sample

EPOCH = 1.7e9


class Core(Protocol):
    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]: ...


@dataclass
class Node:
    """One process: its core, what it subscribes to, how often it wakes by itself."""

    core: Core
    keys: frozenset[str]
    period: float
    clock_error: float = 0.0
    alive: bool = True


@dataclass
class Fleet:
    """Leader, agents and simulated robots of a mission."""

    mission: Mission
    law: str | None = None
    seed: int = 0
    loss: float = 0.0
    delay: tuple[float, float] = (0.0005, 0.002)
    now: float = 0.0
    commands: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: defaultdict(list))
    meddle: Callable[[Sample], Iterable[Sample]] = lambda sample: (sample,)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.world = World(self.mission, self.mission.followers, seed=self.seed)
        self.leader = Leader(self.mission, started_ns=1)
        self.agents = {name: Agent(self.mission, name, self.law) for name in self.mission.followers}
        odometry = 1.0 / max(self.mission.robots[name].rate for name in self.mission.followers)
        commands = frozenset(CMD_VEL.key(name) for name in self.mission.followers)
        self.nodes = {
            "world": Node(self.world, commands, odometry),
            "leader": Node(self.leader, frozenset(), 1.0 / self.mission.robots[self.mission.leader].rate),
        }
        for name, agent in self.agents.items():
            self.nodes[name] = Node(
                agent, frozenset(agent.subscriptions), 1.0 / self.mission.robots[name].rate
            )
        self._order = itertools.count()
        self._events: list[tuple[float, int, str, Sample | None]] = []
        for name, node in self.nodes.items():
            self._at(self.random.uniform(0.0, node.period), name, None)

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            self.now, _, name, sample = heapq.heappop(self._events)
            node = self.nodes[name]
            if sample is None:
                self._at(self.now + node.period, name, None)
            if node.alive:
                moment = Now(self.now, EPOCH + self.now + node.clock_error)
                self._send(name, node.core.step(moment, [] if sample is None else [sample]))
        self.now = end

    def kill(self, name: str) -> None:
        self.nodes[name].alive = False

    def revive(self, name: str) -> None:
        self.nodes[name].alive = True

    def ask(self, name: str, do: str) -> OperatorReply:
        core = self.leader if name == self.mission.leader else self.agents[name]
        return decode_order(OperatorReply, core.request(encode(OperatorRequest.model_validate({"do": do}))))

    def error(self) -> float:
        """Formation error of the robots as they really are [m]."""
        points = [self.leader.position, *(self.world.control_point(name) for name in self.mission.followers)]
        return float(formation_error(self.mission.graph, np.array(points), self.mission.slots()))

    def last_command(self, name: str) -> tuple[float, float]:
        return self.commands[name][-1][1:]

    def status(self, name: str) -> dict[str, str]:
        return dict(self._status[name].statuses[0].values)

    _status: dict[str, Diagnostics] = field(default_factory=dict)

    def _at(self, moment: float, name: str, sample: Sample | None) -> None:
        heapq.heappush(self._events, (moment, next(self._order), name, sample))

    def _send(self, sender: str, outbox: list[Outgoing]) -> None:
        for out in outbox:
            self._note(sender, out)
            for name, node in self.nodes.items():
                if name == sender or out.key not in node.keys:
                    continue
                between_robots = out.key.endswith("/position")
                if between_robots and self.random.random() < self.loss:
                    continue
                wait = self.random.uniform(*self.delay) if between_robots else 0.0005
                for sample in self.meddle(Sample(out.key, out.payload, out.attachment, self.now + wait)):
                    self._at(self.now + wait, name, sample)

    def _note(self, sender: str, out: Outgoing) -> None:
        if sender in self.agents and out.key == CMD_VEL.key(sender):
            kind = self.mission.robots[sender].cmd_vel
            twist = decode(Twist, out.payload) if kind == "twist" else decode(TwistStamped, out.payload)
            self.commands[sender].append((self.now, twist.speed, twist.turn_rate))
        elif sender in self.agents and out.key == STATUS.key(sender):
            self._status[sender] = decode(Diagnostics, out.payload)


def keys_of_neighbours(mission: Mission, name: str) -> set[str]:
    return {ODOM.key(name)} | {POSITION.key(other) for other in mission.robots[name].neighbours}
