"""A fleet on a fake clock whose agents run in their loops, and what a monitor would have recorded of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from formation.agent.core import Agent
from formation.agent.persistence.persistence import Persistence
from formation.agent.process import Sides
from formation.agent.verify.core import COMMAND_TOLERANCE, Verdict, Verification
from formation.mission.model import Mission
from formation.protocol.json_message import decode, encode
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.topics import POSITION, Topic
from formation.transport.runtime.process import clocks
from formation.wire import Now, Outgoing, Sample
from tests.support.fleet import EPOCH, Fleet, named

Recording = list[tuple[Sample, float]]
"""Each message, and when it was recorded [s, recorder's system clock]."""


class Wire:
    """One side of an agent."""

    def __init__(self) -> None:
        self.connected, self.listens = True, True
        self.refused: dict[str, int] = {}
        self.said: list[Outgoing] = []

    def advertise(self, _topic: Topic, _key: str) -> None:
        pass

    def subscribe(self, *_where: Any, **_how: Any) -> None:
        pass

    def routed(self, _key: str) -> bool | None:
        return self.listens if self.connected else None

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        self.said.append(Outgoing(key, payload, attachment))


class Looped:
    """An agent in its loop, as a core: to its robot goes what the loop sends there, the rest to the fleet."""

    def __init__(
        self,
        agent: Agent,
        record: Recording,
        *,
        persistence: Persistence | None = None,
        clock: Callable[[], Now] = clocks,
    ) -> None:
        self.agent, self.record = agent, record
        self.fleet, self.robot = Wire(), Wire()
        process: Any = SimpleNamespace(
            bus=self.fleet, robot=self.robot, clock=clock, let_threads_run=lambda: None
        )
        self.sides = Sides(agent, process, persistence=persistence)
        self.sides.declare()
        self.publications, self.subscriptions = agent.publications, agent.subscriptions
        self.dropped = agent.dropped

    @property
    def due(self) -> float:
        return self.agent.due

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        self.sides.send(self.sides.step(now, inbox))
        return self._spoken(now)

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        self.sides.send(self.sides.halt(now, reason))
        return self._spoken(now)

    def _spoken(self, now: Now) -> list[Outgoing]:
        self.record += [(Sample(*out, now.mono), EPOCH + now.mono) for out in self.fleet.said]
        position = POSITION.key(self.agent.robot)
        result = [out for out in self.robot.said if out.key != position]
        result += [out for out in self.fleet.said if out.key == position]  # with the order
        self.robot.said, self.fleet.said = [], []
        return result


@dataclass
class RecordedFleet(Fleet):
    """A fleet, and its recording."""

    record: Recording = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, agent in self.agents.items():
            self.nodes[name].core = Looped(agent, self.record)

    def loop(self, name: str) -> Looped:
        core = self.nodes[name].core
        assert isinstance(core, Looped)
        return core

    def restart(self, name: str) -> None:
        super().restart(name)
        if name in self.agents:
            self.nodes[name].core = Looped(self.agents[name], self.record)

    def halt(self, name: str) -> None:
        self._send(name, self.loop(name).halt(self.moment, "told to"))
        self.kill(name)

    def tell(self, name: str, do: str, **more: Any) -> OperatorReply:
        """Ask an agent in its loop, or the leader."""
        requested = self.leader if name == self.mission.leader else self.loop(name).sides
        request = named(
            OperatorRequest.model_validate({"do": do, **more}), lambda data: requested.request(data, self.now)
        )
        return decode(OperatorReply, requested.request(encode(request), self.now))

    def _note(self, sender: str, out: Outgoing) -> None:
        super()._note(sender, out)
        if sender == "leader":
            self.record.append((Sample(*out, self.now), EPOCH + self.now))


def all_alike(verdicts: dict[str, Verdict]) -> bool:
    """Whether every command of all robots was computed again to the last bit."""
    return all(one.exact == one.compared == one.commands > 0 for one in verdicts.values())


def verify(
    mission: Mission,
    messages: Iterable[tuple[Sample, float]],
    law: str | None = None,
    tolerance: float = COMMAND_TOLERANCE,
) -> dict[str, Verdict]:
    """Return each robot's verdict; `messages` with times [s, recorder's clock], in recorded order."""
    verification = Verification(mission, law, tolerance)
    for sample, wall in messages:
        verification.process_sample(sample, wall)
    verification.close()
    return verification.verdicts
