"""Real candidates and agents with a simulated network and faults, and the invariants of an election.

Robots do not move: the checks are about leadership, orders and obedience.
"""

from __future__ import annotations

import heapq
import itertools
import json
import random
from collections.abc import Iterable
from dataclasses import dataclass, field

from formation.agent.core import Agent
from formation.agent.persistence.restore import Restorer
from formation.agent.status import Surroundings
from formation.leader.core import Leader
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.election import reach
from formation.protocol.order import Order
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import AgentState
from formation.ros2.messages import Odometry, encode
from formation.stability import intent
from formation.topics import ALIVE, ODOM, POSITION
from formation.wire import Now, Outgoing, Sample
from tests.support.fleet import named
from tests.support.missions import row_of_three

EPOCH = 1.7e9
TICK = 0.1
"""Tick of `MISSION` [s]."""
TWIN = "-twin"
"""Suffix of the name of a robot's second agent."""
MISSION: Mission = parse(
    row_of_three(
        "chain",
        rate=5,
        speed=0.01,
        takeover="takeover = 2.0",
        tables="""\
[standbys.first]
[standbys.second]
[shapes.far]
a = [-2.0, 0.0]
b = [-4.0, 0.0]
c = [-6.0, 0.0]
""",
    )
)


def chain(followers: int = 3, standbys: int = 2, takeover: float = 1.0, rate: float = 20.0) -> Mission:
    """Robots f0, f1, … behind a leader ``led`` that standbys s0, s1, … can replace."""
    names = [f"f{number}" for number in range(followers)]
    lines = [
        'name = "chain"',
        'leader = "led"',
        f"takeover = {takeover}",
        "[robot]",
        f"rate = {rate}",
    ]
    lines += [f"[standbys.s{number}]" for number in range(standbys)]
    lines += ["[shapes.row]", *(f"{name} = [{-1.0 - number}, 0.0]" for number, name in enumerate(names))]
    lines += ["[robots.led]", "start = { x = 0, y = 0 }"]
    for before, name in zip(["led", *names], names, strict=False):
        lines += [f"[robots.{name}]", f'neighbours = ["{before}"]']
        lines += [f"start = {{ x = {-1 - int(name[1:])}, y = 0 }}"]
    return parse("\n".join([*lines, "[[route]]", "speed = 0.01", "heading_deg = 0"]))


@dataclass
class Process:
    """A candidate or an agent, its clocks and its faults."""

    core: Leader | Agent
    phase: float
    """Its turn comes this long after each tick [s]."""
    offset: float
    """Offset of its monotonic clock [s]."""
    pace: float = 1.0
    """Rate of its monotonic clock."""
    wrong: float = 0.0
    """Error of its system clock [s]."""
    alive: bool = True
    frozen: bool = False
    inbox: list[Sample] = field(default_factory=list)
    odometry_due: float = 0.0
    stopped: bool = False
    """It has acknowledged a stop, and no release since."""
    requested: set[str] = field(default_factory=set)
    """Ids of requests that it has acknowledged."""
    readonly: bool = False
    """An agent that sends its robot nothing."""
    disk: int = 0
    """Of a candidate: the newest term on its disk."""

    def now(self, true: float) -> Now:
        return Now(self.offset + true * self.pace, EPOCH + self.wrong + true)


class Team:
    """Every process, and the network between them."""

    def __init__(self, seed: int, mission: Mission = MISSION, drift: float = 0.0) -> None:
        """Clocks run up to `drift` faster or slower than true time."""
        self.mission = mission
        self.tick, self._period = mission.takeover / 20.0, 1.0 / mission.robots[mission.leader].rate
        self._longest_sign = reach(mission) - self.tick  # it may wait a tick for its reader
        self.random, self.true = random.Random(seed), 0.0
        self.loss = self.twice = 0.0
        self.slowest = 0.01
        """Longest delay of a message [s]."""
        self.missions: dict[str, Mission] = {}
        """Missions of processes that run another one than the team."""
        self.keeps = False
        """Whether candidates keep their newest term on disk."""
        self.cuts: set[tuple[str, str]] = set()
        """Pairs of a sender and a receiver that does not receive it."""
        self.sent_orders: dict[tuple[int, int], Order] = {}
        """All orders ever sent, by term and beat."""
        self.leader_terms: list[tuple[str, int]] = []
        self._flight: list[tuple[float, int, str, Sample]] = []
        self._serial = itertools.count()
        names = (*self.mission.candidates, *self.mission.followers)
        self.processes = {
            name: Process(
                self._core(name), self.random.uniform(0.0, 0.9 * self.tick), self.random.uniform(0.0, 1e5)
            )
            for name in names
        }
        paces = random.Random(seed)
        for process in self.processes.values():
            process.pace += paces.uniform(-drift, drift)
        self.agents = self.mission.followers

    def leader(self, name: str) -> Leader:
        core = self.processes[name].core
        assert isinstance(core, Leader)
        return core

    def agent(self, name: str) -> Agent:
        core = self.processes[name].core
        assert isinstance(core, Agent)
        return core

    def twin(self, robot: str, *, readonly: bool = False) -> None:
        """Start a second agent for this robot."""
        name, before = robot + TWIN, self.processes[robot]
        self.processes[name] = Process(
            self._core(name, readonly=readonly),
            self.random.uniform(0.0, 0.9 * self.tick),
            self.random.uniform(0.0, 1e5),
            wrong=before.wrong,
            readonly=readonly,
        )

    def end(self, name: str) -> None:
        """End a candidate in good order; its last position, which it sends without a lease, is lost."""
        process = self.processes[name]
        last = self.leader(name).halt(process.now(self.true), "ended")
        self._send(name, [out for out in last if out.key != POSITION.key(self.mission.leader)])
        process.alive = False

    def end_twins(self) -> None:
        for name in self.processes:
            self.processes[name].alive &= not name.endswith(TWIN)

    def restart(self, name: str) -> None:
        """Start a new process; an agent reads its stop from disk, a candidate its newest term, if stored."""
        process = self.processes[name]
        kept = None
        if isinstance(process.core, Agent):
            kept = json.dumps(Restorer(process.core, "boot").stops).encode()
        process.core = self._core(name, readonly=process.readonly, known=process.disk)
        process.alive, process.frozen, process.inbox = True, False, []
        if kept is not None:
            Restorer(self.agent(name), "boot").take_stops(kept, process.now(self.true), "stops")
        else:
            process.stopped, process.requested = False, set()

    def thaw(self, name: str) -> None:
        """Continue a frozen process; messages that came meanwhile count as arrived now."""
        process = self.processes[name]
        if process.frozen:
            late = process.now(self.true).mono
            signs = [sample for sample in process.inbox if _is_sign(sample)]
            process.inbox = [sample._replace(arrived=late) for sample in process.inbox if sample not in signs]
            for sample in signs:  # they waited in another socket, which may be read later
                self._sign(name, sample)
        process.frozen = False

    def stand(self, name: str) -> None:
        """Let a standby ask for votes without waiting."""
        process, candidacy = self.processes[name], self.leader(name).candidacy
        if process.alive and not process.frozen and candidacy.state == "standby":
            now = process.now(self.true)
            candidacy._become_candidate(now)

    def ask(self, name: str, request: OperatorRequest) -> None:
        """Send one process an operator request, check its gains, and note what it acknowledges."""
        process = self.processes[name]
        if not process.alive or process.frozen:
            return
        mono = process.now(self.true).mono
        request = named(request, lambda data: process.core.request(data, mono))
        before = process.core.plan.tuned if isinstance(process.core, Leader) else None
        reply = json_message.decode(OperatorReply, process.core.request(json_message.encode(request), mono))
        after = process.core.plan.tuned if isinstance(process.core, Leader) else None
        if not reply.ok or request.id in process.requested or request.do != "tune":
            assert after == before, f"{name} changed its gains without a new request"
        elif isinstance(process.core, Leader):
            assert process.core.plan.gains == intent.tuned(request, process.core.plan.gains)
        if reply.ok and request.id not in process.requested and request.do in {"stop", "release"}:
            process.stopped = request.do == "stop"
        if reply.ok:  # a request refused by a standby may be repeated when that standby leads
            process.requested.add(request.id)

    def run(self, seconds: float) -> None:
        """Run all processes; raise AssertionError as soon as an invariant is violated."""
        for _ in range(round(seconds / self.tick)):
            start = self.true
            for name, process in sorted(self.processes.items(), key=lambda item: item[1].phase):
                self.true = start + process.phase
                self._arrive()
                if process.alive and not process.frozen:
                    self._turn(name, process)
                    self._check(name, process)
            self.true = start + self.tick

    def heal(self) -> None:
        """End all faults and start dead processes again."""
        self.loss = self.twice = 0.0
        self.slowest = 0.01
        self.cuts.clear()
        for name, process in self.processes.items():
            self.thaw(name)
            process.wrong = 0.0
            if not process.alive:
                self.restart(name)

    @property
    def leaders(self) -> list[str]:
        """Candidates whose lease is valid now by their own clocks."""
        return [name for name in self.mission.candidates if self._in_lease(name)]

    @property
    def agreed(self) -> bool:
        """Whether exactly one candidate leads and all agents obey it."""
        if len(self.leaders) != 1:
            return False
        led = self.leader(self.leaders[0])
        orders = [self.agent(name).orders for name in self.agents]
        return all(
            one.voter.state.voted_term == (led.term if self.mission.standbys else 0)
            and one.newest is not None
            and one.newest.term == led.term
            and one.newest.mode == led.mode
            and one.newest.shape == led.plan.shape_transition.ordered.shape
            and one.newest.tuned == led.plan.tuned
            for one in orders
        )

    def _core(self, name: str, *, readonly: bool = False, known: int = 0) -> Leader | Agent:
        publisher_id = f"publisher{next(self._serial)}" if hasattr(self, "_serial") else "publisher"
        if name in self.mission.candidates:
            return Leader(self.missions.get(name, self.mission), name, publisher_id=publisher_id, known=known)
        mission = self.missions.get(name, self.mission)
        return Agent(mission, name.removesuffix(TWIN), publisher_id=publisher_id, readonly=readonly)

    def _in_lease(self, name: str) -> bool:
        process, candidacy = self.processes[name], self.leader(name).candidacy
        return (
            process.alive
            and candidacy.leading
            and (not self.mission.standbys or process.now(self.true).mono < candidacy._lease)
        )

    def _arrive(self) -> None:
        while self._flight and self._flight[0][0] <= self.true:
            when, _, receiver, sample = heapq.heappop(self._flight)
            process = self.processes[receiver]
            if process.alive:
                process.inbox.append(sample._replace(arrived=process.now(when).mono))

    def _turn(self, name: str, process: Process) -> None:
        now = process.now(self.true)
        inbox, process.inbox = process.inbox, []
        if isinstance(process.core, Agent) and self.true >= process.odometry_due:
            process.odometry_due = self.true + self._period - 1e-9
            start = self.mission.robots[name.removesuffix(TWIN)].start
            odometry = Odometry(now.wall, start.position, start.heading, 0.0, 0.0)
            inbox.append(Sample(ODOM.key(process.core.robot), encode(odometry), None, now.mono))
        if inbox or process.core.due <= now.mono:
            if isinstance(process.core, Agent):
                process.core.aware(Surroundings(rival=any(map(_is_sign, inbox))))
                received = [sample for sample in inbox if not _is_sign(sample)]
                self._agent_steps(name, process, process.core, received)
            else:
                self._send(name, process.core.step(now, inbox))
                process.disk = process.core.known if self.keeps else 0

    def _agent_steps(self, name: str, process: Process, agent: Agent, inbox: list[Sample]) -> None:
        orders = agent.orders
        before = orders.newest
        self._send(name, agent.step(process.now(self.true), inbox))
        if orders.newest is not None and orders.newest is not before:
            assert orders.newest.term >= orders.voter.state.voted_term, f"{name} obeys an older term"
        if process.stopped:
            assert agent.decision.state is AgentState.STOP, f"{name} does not obey its stop"

    def _check(self, name: str, process: Process) -> None:
        """Check the invariants after each turn."""
        if isinstance(process.core, Agent):
            assert not process.stopped or process.core.latch.mode == "stop", f"{name} lost a stop"
            newest = process.core.orders.newest
            assert newest is None or self.sent_orders[newest.term, newest.beat] == newest
            return
        assert not process.stopped or process.core.mode == "stop", f"{name} lost a stop"
        leaders = self.leaders
        assert len(leaders) <= 1, f"{leaders} lead at once"
        for one in leaders:
            if self.leader_terms[-1:] != [(one, self.leader(one).term)]:
                self.leader_terms.append((one, self.leader(one).term))

    def _send(self, sender: str, outbox: Iterable[Outgoing]) -> None:
        for out in outbox:
            if out.key == POSITION.key(self.mission.leader):
                self._note(sender, out)
            if out.key.endswith(f"/{ALIVE.name}") and not self.processes[sender].readonly:
                for name, other in self.processes.items():
                    if (
                        name != sender
                        and isinstance(other.core, Agent)
                        and out.key == ALIVE.key(other.core.robot)
                    ):
                        self._sign(name, Sample(*out, 0.0))
            for receiver, process in self.processes.items():
                if receiver == sender or (sender, receiver) in self.cuts:
                    continue
                if out.key in process.core.subscriptions:
                    self._deliver(receiver, Sample(out.key, out.payload, out.attachment, 0.0))

    def _note(self, sender: str, out: Outgoing) -> None:
        """Check that an order is sent with a lease, and no other order with its term and beat."""
        assert self._in_lease(sender), f"{sender} orders without a lease"
        result = json_message.decode(PositionAttachment, out.attachment or b"").order
        assert result is not None
        assert self.sent_orders.setdefault((result.term, result.beat), result) == result

    def _sign(self, receiver: str, sample: Sample) -> None:
        """Deliver a sign of life on the robot's own side: never cut or lost, with a short delay."""
        when = self.true + self.random.uniform(0.0, self._longest_sign)
        heapq.heappush(self._flight, (when, next(self._serial), receiver, sample))

    def _deliver(self, receiver: str, sample: Sample) -> None:
        for _ in range(1 + (self.random.random() < self.twice)):
            if self.random.random() >= self.loss:
                when = self.true + self.random.uniform(0.0, self.slowest)
                heapq.heappush(self._flight, (when, next(self._serial), receiver, sample))


def _is_sign(sample: Sample) -> bool:
    """Whether it is another agent's sign of life."""
    return sample.key.endswith(f"/{ALIVE.name}")
