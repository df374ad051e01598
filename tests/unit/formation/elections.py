"""Voters and candidates in a world where everything may happen to messages, clocks and processes."""

from __future__ import annotations

import heapq
import itertools
import random
from contextlib import suppress
from dataclasses import dataclass, field

from formation.agent.following.orders import Orders
from formation.leader.candidacy import Candidacy
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol.election import without_absurd_terms
from formation.protocol.order import Ballot, Order, PositionAttachment
from formation.wire import BadMessage, Now

EPOCH = 1.7e9
TICK = 0.01
"""[s]"""
TOLD = 0.05
"""A follower tells its position so often [s]."""
TWIN = "-twin"
"""How the name of a second agent of a robot ends."""
ALIVE = "alive"
"""A sign of life."""


def mission(followers: int = 3, standbys: int = 2, takeover: float = 1.0) -> Mission:
    """A chain of followers behind a leader that can be replaced."""
    names = [f"f{number}" for number in range(followers)]
    lines = ['name = "chain"', 'leader = "led"', f"takeover = {takeover}"]
    lines += [f"[standbys.s{number}]" for number in range(standbys)]
    lines += ["[shapes.row]", *(f"{name} = [{-1.0 - number}, 0.0]" for number, name in enumerate(names))]
    lines += ["[robots.led]", "start = { x = 0, y = 0 }"]
    for before, name in zip(["led", *names], names, strict=False):
        lines += [f"[robots.{name}]", f'neighbours = ["{before}"]']
        lines += [f"start = {{ x = {-1 - int(name[1:])}, y = 0 }}"]
    return parse("\n".join([*lines, "[[route]]", "speed = 0.1", "heading_deg = 0"]))


@dataclass
class Process:
    """One voter or candidate: what it is, its clocks, and what happens to it."""

    core: Orders | Candidacy
    offset: float
    """Of its monotonic clock [s]."""
    pace: float
    """How fast that runs."""
    wall: float = EPOCH
    """Of its system clock [s]."""
    alive: bool = True
    frozen: bool = False
    inbox: list[tuple[str, object, float]] = field(default_factory=list)
    beat: int = 0
    published: float = 0.0
    count: int = 0
    robot: str = ""
    """Of an agent: which robot it speaks for."""
    publisher: str = ""
    """Drawn anew whenever it starts."""

    def now(self, true: float) -> Now:
        return Now(self.offset + true * self.pace, self.wall + true)


class World:
    """Steps every process each tick; what they say takes ways of its own."""

    def __init__(self, of: Mission, seed: int = 0) -> None:
        self.mission, self.random, self.true = of, random.Random(seed), 0.0
        self.loss = self.twice = 0.0
        self.slowest = 0.01
        """Longest delay of a message [s]."""
        self.cut: set[tuple[str, str]] = set()
        """Who is not received by whom."""
        self.flight: list[tuple[float, int, str, str, object]] = []
        self.serial = itertools.count()
        self.processes: dict[str, Process] = {}
        self.processes = {name: self.process(name) for name in (*of.candidates, *of.followers)}
        self.leader_terms: list[tuple[str, int]] = []
        """Who led in which term, one after the other."""

    def process(self, name: str) -> Process:
        core = Candidacy(self.mission, name) if name in self.mission.candidates else Orders(self.mission)
        robot, publisher = name.removesuffix(TWIN), f"p{next(self.serial)}"
        offset, pace = self.random.uniform(0.0, 1e5), self.random.uniform(0.97, 1.03)
        return Process(core, offset, pace, robot=robot, publisher=publisher)

    def twin(self, robot: str) -> None:
        """A second agent for `robot` starts, or starts anew."""
        self.processes[robot + TWIN] = self.process(robot + TWIN)

    @property
    def twins(self) -> list[str]:
        """Agents that are not the first of their robot."""
        return [name for name in self.processes if name.endswith(TWIN)]

    def candidacy(self, name: str) -> Candidacy:
        core = self.processes[name].core
        assert isinstance(core, Candidacy)
        return core

    def orders(self, name: str) -> Orders:
        core = self.processes[name].core
        assert isinstance(core, Orders)
        return core

    def restart(self, name: str) -> None:
        """Forgets everything; its clocks go on."""
        before = self.processes[name]
        fresh = self.process(name)
        fresh.offset, fresh.pace, fresh.wall = before.offset, before.pace, before.wall
        self.processes[name] = fresh

    def stand(self, name: str) -> None:
        """It stands without waiting for anybody: who is safe must not rely on patience."""
        process, core = self.processes[name], self.candidacy(name)
        now = process.now(self.true)
        if process.alive and not process.frozen and core.state == "standby":
            core._begin(now)

    def freeze(self, name: str) -> None:
        self.processes[name].frozen = True

    def thaw(self, name: str) -> None:
        """What came meanwhile waits for it; its receiving thread has seen it only now, or in time."""
        process = self.processes[name]
        if process.frozen and self.random.random() < 0.5:
            late = process.now(self.true).mono
            process.inbox = [(sender, what, late) for sender, what, _ in process.inbox]
        if process.frozen:  # signs of life came by another socket, which may be read later
            signs = [one for one in process.inbox if one[1] == ALIVE]
            process.inbox = [one for one in process.inbox if one[1] != ALIVE]
            for _ in signs:
                self._sign(process.robot, name)
        process.frozen = False

    def leaders(self) -> list[str]:
        """Who is in lease at this moment, by its own clock."""
        return [
            name
            for name in self.mission.candidates
            if self.candidacy(name).leading
            and self.processes[name].alive
            and self.processes[name].now(self.true).mono < self.candidacy(name)._lease
        ]

    def run(self, seconds: float) -> None:
        """Raises AssertionError as soon as two lead at once."""
        for _ in range(round(seconds / TICK)):
            self.true += TICK
            while self.flight and self.flight[0][0] <= self.true:
                _, _, sender, receiver, what = heapq.heappop(self.flight)
                process = self.processes[receiver]
                if process.alive:
                    process.inbox.append((sender, what, process.now(self.true).mono))
            for name in self.random.sample(list(self.processes), len(self.processes)):
                process = self.processes[name]
                if process.alive and not process.frozen:
                    inbox, process.inbox = process.inbox, []
                    if isinstance(process.core, Candidacy):
                        self._candidate(name, process, inbox)
                    else:
                        self._follower(name, process, inbox)
            leaders = self.leaders()
            assert len(leaders) <= 1, leaders
            for name in leaders:
                if self.leader_terms[-1:] != [(name, self.candidacy(name).term)]:
                    self.leader_terms.append((name, self.candidacy(name).term))

    def heal(self) -> None:
        self.loss = self.twice = 0.0
        self.slowest = 0.01
        self.cut.clear()
        for name in self.processes:
            self.thaw(name)

    def _candidate(self, name: str, process: Process, inbox: list[tuple[str, object, float]]) -> None:
        now, core = process.now(self.true), self.candidacy(name)
        for sender, what, arrived in inbox:
            with suppress(BadMessage):
                if isinstance(what, PositionAttachment):
                    attachment = without_absurd_terms(what, now)
                    core.receive(self.processes[sender].robot, attachment, arrived, now)
                elif isinstance(what, Ballot):
                    core.receive_ballot(what, sender, arrived, now)
        ballot = core.step(now)
        if ballot is not None:
            self._say(name, (*self.mission.candidates, *self._agents(self.mission.followers)), ballot)
        if core.leading and now.mono - process.published >= TOLD:
            process.published, process.beat = now.mono, process.beat + 1
            order = Order(term=core.term, beat=process.beat, mode="run", shape="row")
            attachment = PositionAttachment(
                publisher_id=process.publisher, count=process.beat, order=order, mission=self.mission.tag
            )
            self._say(name, self._agents(self.mission.followers[:1]), attachment)

    def _follower(self, name: str, process: Process, inbox: list[tuple[str, object, float]]) -> None:
        now, core = process.now(self.true), self.orders(name)
        core.voter.aware(now.mono, rival=any(what == ALIVE for _, what, _ in inbox))
        for sender, what, arrived in inbox:
            with suppress(BadMessage):
                if isinstance(what, Ballot):
                    core.voter.receive(what, sender, arrived, now)
                elif isinstance(what, PositionAttachment) and what.order is not None:
                    core.receive(what.order, sender, arrived, now)
        if now.mono - process.published >= TOLD:
            process.published, process.count = now.mono, process.count + 1
            voter = core.voter
            voter.commanded(now.mono)
            for other in self._agents((process.robot,)):
                if other != name:
                    self._sign(name, other)
            attachment = PositionAttachment(
                publisher_id=process.publisher,
                count=process.count,
                order=core.newest,
                voted_term=voter.state.voted_term,
                last_ballot=voter.state.last_ballot,
                mission=self.mission.tag,
                refused=voter.state.refused,
                because=voter.state.because,
            )
            number = self.mission.followers.index(process.robot)
            self._say(
                name,
                (*self.mission.candidates, *self._agents(self.mission.followers[number + 1 : number + 2])),
                attachment,
            )

    def _agents(self, robots: tuple[str, ...]) -> tuple[str, ...]:
        """All processes that speak for these robots."""
        return tuple(name for name, one in self.processes.items() if one.robot in robots)

    def _sign(self, sender: str, receiver: str) -> None:
        """A sign of life on a robot's own side, which is neither cut nor lost, and comes soon."""
        soon = max(0.1 * self.mission.takeover, 2.0 * TOLD) - 3 * TICK
        when = self.true + self.random.uniform(0.0, soon)
        heapq.heappush(self.flight, (when, next(self.serial), sender, receiver, ALIVE))

    def _say(self, sender: str, receivers: tuple[str, ...], what: object) -> None:
        for receiver in receivers:
            if receiver == sender or (sender, receiver) in self.cut:
                continue
            for _ in range(1 + (self.random.random() < self.twice)):
                if self.random.random() >= self.loss:
                    when = self.true + self.random.uniform(0.0, self.slowest)
                    heapq.heappush(self.flight, (when, next(self.serial), sender, receiver, what))
