"""A whole fleet in one process: production cores on a fake clock over a lossy network in memory.

Nothing here knows the law. Each core is stepped as its loop would step it: at once when something arrives for
it, and by its timer when nothing does.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from agent.core import Agent
from agent.robots.simulated import World
from formation.graph import formation_error
from formation.mission import Mission
from formation.order import OperatorReply, OperatorRequest, encode
from formation.order import decode as decode_order
from formation.ros2.messages import Diagnostics, Twist, TwistStamped, decode
from formation.topics import CMD_VEL, ODOM, POSITION, STATUS
from formation.transport.process import Core
from formation.wire import Now, Outgoing, Sample
from leader.core import Leader

EPOCH = 1.7e9


@dataclass
class Node:
    """One process: its core, and how wrong its system clock is [s]."""

    core: Core
    clock_error: float = 0.0
    alive: bool = True
    wake: int = 0
    """Which of its wake-ups counts: the newest."""


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
        self.world = World(self.mission, seed=self.seed)
        self.voices = (f"voice{number}" for number in itertools.count())
        self.leader = Leader(self.mission, voice=next(self.voices))
        self.agents = {name: self.new_agent(name) for name in self.mission.followers}
        cores: dict[str, Core] = {"world": self.world, "leader": self.leader, **self.agents}
        self.nodes = {name: Node(core) for name, core in cores.items()}
        self._number = itertools.count()
        self._events: list[tuple[float, int, str, Sample | None]] = []
        self._said: dict[str, Diagnostics] = {}
        for name in self.nodes:
            self._wake(name, self.random.uniform(0.0, 0.05))

    def new_agent(self, name: str) -> Agent:
        """As its process would make it when it starts."""
        return Agent(self.mission, name, self.law, voice=next(self.voices))

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            self.now, number, name, sample = heapq.heappop(self._events)
            node = self.nodes[name]
            if not node.alive or (sample is None and number != node.wake):
                continue
            moment = Now(self.now, EPOCH + self.now + node.clock_error)
            self._send(name, node.core.step(moment, [] if sample is None else [sample]))
            self._wake(name, node.core.due)
        self.now = end

    def kill(self, name: str) -> None:
        self.nodes[name].alive = False

    def revive(self, name: str) -> None:
        self.nodes[name].alive = True
        self._wake(name, self.now)

    def ask(self, name: str, do: str) -> OperatorReply:
        core = self.leader if name == self.mission.leader else self.agents[name]
        return decode_order(OperatorReply, core.request(encode(OperatorRequest.model_validate({"do": do}))))

    def take(self, shape: str) -> OperatorReply:
        """Have the leader ask for another shape."""
        request = OperatorRequest(do="shape", shape=shape)
        return decode_order(OperatorReply, self.leader.request(encode(request)))

    def error(self) -> float:
        """Formation error of the robots as they really are, now, in the shape that is ordered [m]."""
        slots = self.mission.slots(self.leader.shape)
        return float(formation_error(self.mission.graph, np.array(self.points()), slots))

    def points(self) -> list[complex]:
        """The leader, and the robots' control points as they really are, now [m; world frame]."""
        points = [self._leader_position()]
        for name in self.mission.followers:
            robot = self.world._hosted[name]
            robot.go_to(self.now)
            points.append(robot.control_point)
        return points

    def _leader_position(self) -> complex:
        moving = self.leader.mode == "run" and self.leader._stepped is not None
        since = self.now - self.leader._stepped if moving and self.leader._stepped is not None else 0.0
        return complex(self.leader._route.position(self.leader.route_time + since))

    def last_command(self, name: str) -> tuple[float, float]:
        return self.commands[name][-1][1:]

    def status(self, name: str) -> dict[str, str]:
        return dict(self._said[name].statuses[0].values)

    def _wake(self, name: str, moment: float) -> None:
        """Have a node step by itself, a little after it asked for it, as a real loop would."""
        self.nodes[name].wake = next(self._number)
        moment = max(moment, self.now) + 1e-4
        heapq.heappush(self._events, (moment, self.nodes[name].wake, name, None))

    def _deliver(self, name: str, sample: Sample) -> None:
        heapq.heappush(self._events, (sample.arrived, next(self._number), name, sample))

    def _send(self, sender: str, outbox: Iterable[Outgoing]) -> None:
        for out in outbox:
            self._note(sender, out)
            for name, node in self.nodes.items():
                if out.key not in node.core.subscriptions:
                    continue
                between_robots = out.key.endswith("/position")
                if between_robots and self.random.random() < self.loss:
                    continue
                wait = self.random.uniform(*self.delay) if between_robots else 0.0005
                for sample in self.meddle(Sample(out.key, out.payload, out.attachment, self.now + wait)):
                    self._deliver(name, sample)

    def _note(self, sender: str, out: Outgoing) -> None:
        if sender in self.agents and out.key == CMD_VEL.key(sender):
            kind = self.mission.robots[sender].cmd_vel
            twist = decode(Twist, out.payload) if kind == "twist" else decode(TwistStamped, out.payload)
            self.commands[sender].append((self.now, twist.speed, twist.turn_rate))
        elif sender in self.agents and out.key == STATUS.key(sender):
            self._said[sender] = decode(Diagnostics, out.payload)


def keys_of_neighbours(mission: Mission, name: str) -> set[str]:
    return {ODOM.key(name)} | {POSITION.key(other) for other in mission.robots[name].neighbours}
