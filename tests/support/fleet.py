"""A whole fleet in one process: production cores on a fake clock over a lossy network in memory.

Nothing here knows the law. Each core is stepped as its loop would step it: at once when a message arrives
that wakes it, otherwise by its timer.
"""

from __future__ import annotations

import copyreg
import heapq
import itertools
import math
import random
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, Self, cast

import numpy as np

from formation.agent import process
from formation.agent.core import Agent
from formation.agent.simulated.faults import Faulty
from formation.agent.simulated.plant import Moving, Plant
from formation.agent.simulated.simulated import World, kinematic
from formation.leader.core import Leader
from formation.mission.model import Mission
from formation.protocol.json_message import decode as decode_order
from formation.protocol.json_message import encode
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import AgentState, AgentStatus
from formation.protocol.status_codec import decode as decode_status
from formation.ros2.messages import Diagnostics, Status, Twist, TwistStamped, decode
from formation.simulation.edges import Edges, formation_error
from formation.topics import BALLOT, CMD_VEL, ODOM, POSE, POSITION, ROUTE, STATUS
from formation.transport.runtime.loop import Core
from formation.wire import Now, Outgoing, Sample


def named(request: OperatorRequest, put: Callable[[bytes], bytes]) -> OperatorRequest:
    """`request` with the ids in force at the one that answers `put`; unchanged unless it ends something."""
    if request.do not in {"release", "run"} or request.ends:
        return request
    known = decode_order(OperatorReply, put(encode(OperatorRequest(do="query"))))
    return request.model_copy(update={"ends": tuple(filter(None, (known.stop, known.hold)))})


EPOCH = 1.7e9
MAX_STORED_FLEETS = 8
"""So many fleets that have run for a while are stored, to be copied by the next test."""
# The values of a reason are read-only; copying a fleet copies them.
copyreg.pickle(MappingProxyType, lambda values: (MappingProxyType, (dict(values),)))


def at(mono: float) -> Now:
    """A moment, by clocks that are right."""
    return Now(mono, EPOCH + mono)


WAITING = tuple(f"/{topic.name}" for topic in process.WAITING)
"""How keys end that wake no agent."""
BETWEEN = (f"/{POSITION.name}", f"/{BALLOT.name}", f"/{ROUTE.name}")
"""How keys end that go from robot to robot, over links that lose, delay and repeat."""

OVERHEAD = 80
"""Of a message on a link of limited bandwidth: keys and headers [B]."""


class Link(NamedTuple):
    """What happens to messages on the way from one process to another."""

    loss: float
    """Share that is lost."""
    delay: tuple[float, float]
    """Least and most [s]; what waits longer is overtaken."""
    twice: float = 0.0
    """Share that comes twice."""
    growth: float = 0.0
    """The delay grows by this [s/s] …"""
    since: float = 0.0
    """… from then on [s]."""
    bandwidth: float = math.inf
    """What exceeds this waits in a queue without end [B/s]."""


@dataclass
class PublisherIds:
    """One publisher id after another; unlike a generator it can be copied."""

    count: int = 0

    def __next__(self) -> str:
        self.count += 1
        return f"publisher{self.count - 1}"


class LeaderTerm(NamedTuple):
    """The processes that begin to lead, when, and in which term."""

    since: float
    name: str
    term: int


@dataclass
class Node:
    """One process: its core, and how wrong its system clock is [s]."""

    core: Core
    clock_error: float = 0.0
    alive: bool = True
    wake: int = 0
    """Which of its wake-ups counts: the newest."""
    inbox: list[Sample] = field(default_factory=list)
    """What has arrived for its next step."""
    frozen_at: float = math.inf
    """Since when it is frozen [s]."""
    _known: Core | None = None
    """The core to which `_keys` belong."""
    _keys: frozenset[str] = frozenset()

    def subscribes(self, key: str) -> bool:
        """Whether its core subscribes to a key."""
        if self._known is not self.core:
            self._known, self._keys = self.core, frozenset(self.core.subscriptions)
        return key in self._keys


@dataclass
class Fleet:
    """Candidates, agents and simulated robots of a mission; among the ``nodes`` its leader is "leader"."""

    mission: Mission
    law: str | None = None
    seed: int = 0
    loss: float = 0.0
    delay: tuple[float, float] = (0.0005, 0.002)
    now: float = 0.0
    commands: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: defaultdict(list))
    meddle: Callable[[Sample], Iterable[Sample]] = lambda sample: (sample,)
    links: dict[tuple[str, str], Link] = field(default_factory=dict)
    """Those that are not as all others, by sender and receiver."""
    sensors: dict[str, Link] = field(default_factory=dict)
    """How a robot's own positions come to its agent, where they do not come at once."""
    plants: Callable[[Mission, Sequence[str], int], Mapping[str, Moving]] = kinematic
    """What makes what moves for the robots."""
    cuts: set[tuple[str, str]] = field(default_factory=set)
    """Pairs of sender and receiver that are cut."""
    leader_terms: list[LeaderTerm] = field(default_factory=list)
    most_at_once: int = 0
    """So many were in lease at the same moment."""

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.world = World(self.mission, seed=self.seed, plants=self.plants)
        self.publisher_ids = PublisherIds()
        self.leader = Leader(self.mission, publisher_id=next(self.publisher_ids))
        self.agents = {name: self.new_agent(name) for name in self.mission.followers}
        self.candidates = {
            "leader": self.leader, **{name: self.new_leader(name) for name in self.mission.standbys}
        }  # fmt: skip
        cores: dict[str, Core] = {"world": self.world, **self.candidates, **self.agents}
        self.nodes = {name: Node(core) for name, core in cores.items()}
        self._events_made = 0
        self._events: list[tuple[float, int, str, Sample | None]] = []
        self._published: dict[str, bytes] = {}
        self._commanded = {CMD_VEL.key(name): name for name in self.agents}
        self._reported = {STATUS.key(name): name for name in self.agents}
        self._sent_until: dict[tuple[str, str], float] = defaultdict(float)
        for name in self.nodes:
            self._wake(name, self.random.uniform(0.0, 0.05))

    @classmethod
    def under_way(cls, mission: Mission, seconds: float, law: str | None = None, **options: Any) -> Self:
        """Return a new fleet that has run for so long: a copy of one that did, if there is one.

        A closure over the fleet would not be copied: set `meddle` afterwards.
        """
        how = (cls, seconds, law, options)
        for stored, fleet in STORED_FLEETS:
            if stored == how and fleet.mission == mission:
                return cast("Self", fleet.copy())
        fleet = cls(mission, law, **options).after(seconds)
        STORED_FLEETS.append((how, fleet))
        return fleet.copy()

    def copy(self) -> Self:
        """Return another fleet in the same state, with the same mission."""
        copied = deepcopy(self, {id(self.mission): self.mission})
        for candidate in copied.candidates.values():
            candidate.operator_requests._lead = partial(getattr, candidate, "leadership")
        return copied

    def new_agent(self, name: str) -> Agent:
        """As its process would make it when it starts."""
        return Agent(self.mission, name, self.law, publisher_id=next(self.publisher_ids))

    def new_leader(self, name: str) -> Leader:
        """As the process of a candidate would make it when it starts."""
        return Leader(
            self.mission,
            self.mission.leader if name == "leader" else name,
            publisher_id=next(self.publisher_ids),
        )

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            self.now, number, name, sample = heapq.heappop(self._events)
            node = self.nodes[name]
            if not node.alive or (sample is None and number != node.wake):
                continue
            if sample is not None:
                node.inbox.append(sample)
            if node.frozen_at == math.inf and (sample is None or self._wakes(name, sample.key)):
                self._step(name, node)
        self.now = end

    def _wakes(self, name: str, key: str) -> bool:
        """Whether a message ends the pause of its receiver; others wait for its next step."""
        return name not in self.candidates and not (name in self.agents and key.endswith(WAITING))

    def _step(self, name: str, node: Node) -> None:
        moment = Now(self.now, EPOCH + self.now + node.clock_error)
        inbox, node.inbox = node.inbox, []
        self._send(name, node.core.step(moment, inbox))
        if name in self.candidates:
            self._note_leader_terms()
        self._wake(name, node.core.due)

    def kill(self, name: str) -> None:
        self.nodes[name].alive = False

    def revive(self, name: str) -> None:
        self.nodes[name].alive = True
        self._wake(name, self.now)

    def restart(self, name: str) -> None:
        """As systemd would: a new process, which knows nothing and publishes under a new id."""
        node = self.nodes[name]
        if name in self.candidates:
            node.core = self.candidates[name] = self.new_leader(name)
            self.leader = self.candidates["leader"]
        else:
            node.core = self.agents[name] = self.new_agent(name)
        node.inbox, node.frozen_at = [], math.inf
        self.revive(name)

    def freeze(self, name: str) -> None:
        """As SIGSTOP does."""
        self.nodes[name].frozen_at = self.now

    def thaw(self, name: str) -> None:
        """As SIGCONT does: what waits is read now, and counts as arrived now."""
        node = self.nodes[name]
        node.inbox = [
            one if one.arrived <= node.frozen_at else one._replace(arrived=self.now) for one in node.inbox
        ]
        node.frozen_at = math.inf
        if node.alive:
            self._step(name, node)

    def cut(self, some: Iterable[str], others: Iterable[str]) -> None:
        """Neither hears the other, until `heal`."""
        pairs = set(itertools.product(some, others))
        self.cuts |= pairs | {(other, one) for one, other in pairs}

    def heal(self) -> None:
        """All links are as they were at first; what is queued comes at once."""
        for place, (when, number, name, sample) in enumerate(sorted(self._events, key=lambda one: one[:2])):
            if sample is not None:
                soon = min(when, self.now + 1e-6 * place)
                self._events[place] = soon, number, name, sample._replace(arrived=soon)
            else:
                self._events[place] = when, number, name, None
        heapq.heapify(self._events)
        self.cuts.clear()
        self.links.clear()
        self.sensors.clear()
        self._sent_until.clear()

    @property
    def leaders(self) -> list[str]:
        """Candidates with a lease that has not ended, by the clock and not by their newest step."""
        return [
            name
            for name, one in self.candidates.items()
            if self.nodes[name].alive
            and one.candidacy.leading
            and (not self.mission.standbys or self.now < one.candidacy._lease)
        ]

    @property
    def in_charge(self) -> Leader:
        """The process that leads, or led last; the leader's own before any has."""
        return self.candidates[self.leader_terms[-1].name] if self.leader_terms else self.leader

    def ask(self, name: str, do: str, **what: Any) -> OperatorReply:
        """Have an operator ask a robot, a standby, or by the leader's name the leader's own process.

        What a release or a run ends is asked for first, unless `what` has ``ends``.
        """
        core = {**self.agents, **self.candidates, self.mission.leader: self.leader}[name]
        request = OperatorRequest.model_validate({"do": do, **what})
        if "ends" not in what:
            request = named(request, lambda data: core.request(data, self.now))
        return decode_order(OperatorReply, core.request(encode(request), self.now))

    def set_going(self, name: str) -> OperatorReply:
        """Release one robot and let it run."""
        self.ask(name, "release")
        return self.ask(name, "run")

    def order_shape(self, shape: str) -> OperatorReply:
        """Have the leading process ask for another shape."""
        request = OperatorRequest(do="shape", shape=shape)
        return decode_order(OperatorReply, self.in_charge.request(encode(request), self.now))

    def error(self) -> float:
        """Formation error of the robots as they really are, now, in the shape that is wanted [m]."""
        slots = np.array(self.in_charge.wanted.slots(self.mission))
        return float(formation_error(Edges(self.mission.graph), np.array(self.points()), slots))

    def plant(self, name: str) -> Plant:
        """What moves for a kinematic robot."""
        plant = self.world.plant(name)
        plant = plant.plant if isinstance(plant, Faulty) else plant
        assert isinstance(plant, Plant)
        return plant

    def points(self) -> list[complex]:
        """The leader, and the robots' control points as they really are, now [m; world frame]."""
        points = [self.in_charge.where(self.now)]
        for name in self.mission.followers:
            robot = self.world._hosted[name]
            robot.go_to(self.now)
            points.append(robot.control_point)
        return points

    def _note_leader_terms(self) -> None:
        leaders = self.leaders
        self.most_at_once = max(self.most_at_once, len(leaders))
        for name in leaders:
            leader_term = LeaderTerm(self.now, name, self.candidates[name].term)
            if not self.leader_terms or self.leader_terms[-1][1:] != leader_term[1:]:
                self.leader_terms.append(leader_term)

    def after(self, seconds: float) -> Self:
        """Run, and return the fleet."""
        self.run(seconds)
        return self

    def every(self, step: float, seconds: float) -> Iterator[Self]:
        """Run, and give the fleet after each `step` [s]."""
        return (self.after(step) for _ in range(round(seconds / step)))

    def errors(self, seconds: float) -> list[float]:
        """Run, and return the formation error of every quarter of a second [m]."""
        return [self.error() for _ in self.every(0.25, seconds)]

    def driven(self, name: str, seconds: float) -> float:
        """Run, and return how far the robot drove meanwhile [m]."""
        before = self.plant(name).path
        self.run(seconds)
        return self.plant(name).path - before

    @property
    def moment(self) -> Now:
        """What clocks say now that are right."""
        return at(self.now)

    @property
    def within_limits(self) -> bool:
        """Whether no command has exceeded its robot's limits."""
        return all(
            abs(speed) <= robot.max_speed and abs(turn_rate) <= robot.max_turn_rate
            for name, robot in self.mission.robots.items()
            for _, speed, turn_rate in self.commands[name]
        )

    @property
    def states(self) -> set[AgentState]:
        """The states that the agents are in now."""
        return {agent.decision.state for agent in self.agents.values()}

    def commands_since(self, name: str, moment: float) -> list[tuple[float, float]]:
        """Speed and turn rate of the commands after a moment."""
        return [command[1:] for command in self.commands[name] if command[0] > moment]

    def last_command(self, name: str) -> tuple[float, float]:
        return self.commands[name][-1][1:]

    def message(self, name: str) -> str:
        """What the newest status says in a sentence."""
        return self.reported(name).message

    def status(self, name: str) -> AgentStatus:
        """The newest status."""
        return decode_status(AgentStatus, self.reported(name))

    def reported(self, name: str) -> Status:
        """The newest status as its message has it."""
        return decode(Diagnostics, self._published[name]).statuses[0]

    def _next_number(self) -> int:
        """The number of an event, which orders those of one moment."""
        self._events_made += 1
        return self._events_made - 1

    def _wake(self, name: str, moment: float) -> None:
        """Have a node step by itself, a little after it asked for it, as a real loop would."""
        self.nodes[name].wake = self._next_number()
        moment = max(moment, self.now) + 1e-4
        heapq.heappush(self._events, (moment, self.nodes[name].wake, name, None))

    def _deliver(self, name: str, sample: Sample) -> None:
        heapq.heappush(self._events, (sample.arrived, self._next_number(), name, sample))

    def _send(self, sender: str, outbox: Iterable[Outgoing]) -> None:
        for out in outbox:
            self._note(sender, out)
            for name, node in self.nodes.items():
                if not node.subscribes(out.key):
                    continue
                for wait in self._waits(sender, name, out):
                    for sample in self.meddle(Sample(out.key, out.payload, out.attachment, self.now + wait)):
                        self._deliver(name, sample)

    def _waits(self, sender: str, receiver: str, out: Outgoing) -> Iterable[float]:
        """How long a message is on its way [s], each time that it comes."""
        if not out.key.endswith(BETWEEN):
            own = self.sensors.get(receiver)
            if own is None or out.key not in {ODOM.key(receiver), POSE.key(receiver)}:
                return [0.0005]
            return [self._way(sender, receiver, own, out)]
        if (sender, receiver) in self.cuts:
            return []
        link = self.links.get((sender, receiver), Link(self.loss, self.delay))
        if self.random.random() < link.loss:
            return []
        times = 1 + (link.twice > 0.0 and self.random.random() < link.twice)
        return [self._way(sender, receiver, link, out) for _ in range(times)]

    def _way(self, sender: str, receiver: str, link: Link, out: Outgoing) -> float:
        way = self.random.uniform(*link.delay) + link.growth * (self.now - link.since)
        if link.bandwidth == math.inf:
            return way
        size = OVERHEAD + len(out.payload) + len(out.attachment or b"")
        begins = max(self.now, self._sent_until[sender, receiver])
        self._sent_until[sender, receiver] = begins + size / link.bandwidth
        return way + self._sent_until[sender, receiver] - self.now

    def _note(self, sender: str, out: Outgoing) -> None:
        if self._commanded.get(out.key) == sender:
            kind = self.mission.robots[sender].cmd_vel
            twist = decode(Twist, out.payload) if kind == "twist" else decode(TwistStamped, out.payload)
            self.commands[sender].append((self.now, twist.speed, twist.turn_rate))
        elif self._reported.get(out.key) == sender:
            self._published[sender] = out.payload


STORED_FLEETS: deque[tuple[tuple[Any, ...], Any]] = deque(maxlen=MAX_STORED_FLEETS)
"""How a fleet was made, and the fleet."""
