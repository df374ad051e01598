"""An agent of the present program that repeats the traced steps of a recorded one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from formation.agent.core import Agent
from formation.agent.persistence.state import RESTORED, BadStateError, restore
from formation.agent.status import Surroundings
from formation.agent.verify.buffer import MessageBuffer, Title
from formation.agent.verify.traced import About, BadTraceError, RequestStep, RestoredStep, Step, Traced
from formation.agent.verify.verdict import Comparison, Input, PublishedCommand
from formation.control.laws import LAWS
from formation.mission.model import Mission
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.topics import CMD_VEL
from formation.wire import BadMessage


class RecordedCommand(NamedTuple):
    """A recorded command, and its attachment."""

    traced: Traced
    payload: bytes
    wall: float
    """[s, system clock of the recorder]"""


class Replica:
    """Repeats one publisher id of one robot, from its start or from the next state in its trace on."""

    def __init__(self, mission: Mission, robot: str, law: str | None, late: str) -> None:
        """Use the recorded agent's law unless `law` is given.

        `late` says why its beginning may be missing.
        """
        self._mission, self._robot, self._law, self._late = mission, robot, law, late
        self._command = CMD_VEL.key(robot)
        self._about: About | None = None
        self._number: int | None = None
        self._agent: Agent | None = None
        self._receives: frozenset[str] = frozenset()

    def needs(self, traced: Traced) -> dict[Title, float]:
        """What `traced` needs, and when it arrived; nothing if it cannot be followed.

        Raises BadTraceError.
        """
        about = traced.agent or self._about
        if about is None or self._broken(traced) or (self._agent is None and not self._begins(traced)):
            return {}
        return {Title(key, one.checksum): one.arrived for key, one in traced.received(about.keys)}

    def follow(self, command: RecordedCommand, buffer: MessageBuffer) -> Comparison | str | None:
        """Compare the recorded command with the computed one; or why not, None if reported before.

        Raises BadTraceError.
        """
        traced = command.traced
        if self._number is not None and traced.n <= self._number:
            return "comes a second time"
        broken = self._broken(traced) or _missing(self.needs(traced), buffer)
        begins = self._begins(traced)
        self._number, self._about = traced.n, traced.agent or self._about
        result: Comparison | str | None = broken
        if broken:
            self._agent = None
        elif begins:
            self._agent = self._new_agent()
        if self._agent is not None:
            result = self._compared(self._agent, command, buffer)
        if self._agent is None and traced.state is not None:
            failure = self._restore(traced)
            result = failure if failure and not isinstance(result, Comparison) else result
        return result

    def _begins(self, traced: Traced) -> bool:
        """Whether a fresh agent can follow it."""
        return traced.n == 1 and self._number is None and traced.agent is not None

    def _broken(self, traced: Traced) -> str | None:
        """Why it does not follow from the one before, apart from missing messages."""
        if traced.gap:
            return f"its steps are missing: {traced.gap}"
        if self._number is None:
            return None if traced.n == 1 else self._late
        if missing := self.missing(traced):
            return f"{missing} command{'' if missing == 1 else 's'} before it missing in the recording"
        return None

    def missing(self, traced: Traced) -> int:
        """Number of commands between the one before and this one that are missing in the recording."""
        return 0 if self._number is None else max(0, traced.n - self._number - 1)

    def _new_agent(self) -> Agent:
        """Raises BadTraceError for an unknown law."""
        about = self._about
        if about is None:
            raise BadTraceError("does not say what its agent was made with")
        law = self._law or about.law
        if law not in LAWS:
            raise BadTraceError(f"law {law!r}: must be one of {', '.join(LAWS)}")
        agent = Agent(_named(self._mission, about.mission), self._robot, law, readonly=about.readonly)
        self._receives = frozenset(agent.subscriptions)
        return agent

    def _restore(self, traced: Traced) -> str | None:
        """Restore the recorded agent's state; why not, if that fails."""
        agent = self._new_agent()
        try:
            restore(agent, traced.state)
        except Exception as bad:  # noqa: BLE001 - it may come from any file
            kind = "" if isinstance(bad, BadStateError) else f"{type(bad).__name__}: "
            return f"what its agent knew cannot be taken over: {kind}{bad}"
        self._agent = agent
        return None

    def _compared(self, agent: Agent, command: RecordedCommand, buffer: MessageBuffer) -> Comparison:
        failure = ""
        computed: list[bytes] = []
        try:
            computed.extend(self._live(agent, command.traced, buffer))
        except Exception as error:  # noqa: BLE001 - that today's agent fails is what we are here to find
            self._agent, failure = None, f"fails: {type(error).__name__}: {error}"
        return Comparison(
            command.wall,
            command.traced.n,
            self._read(command.payload),
            self._read(computed[0]) if len(computed) == 1 else None,
            failure or f"{agent.decision.state}: {agent.decision.reason}",
            self._inputs(command.traced),
        )

    def _live(self, agent: Agent, traced: Traced, buffer: MessageBuffer) -> Iterator[bytes]:
        """Take the steps of `traced`; yield the commands that `agent` sends. May raise anything."""
        keys = self._keys
        for step in traced.steps:
            if isinstance(step, RequestStep):
                agent.request(step.request.encode(), step.received)
                continue
            if isinstance(step, RestoredStep):
                RESTORED.read(step.restored, "restored").into(agent)
                continue
            if step.link is not None:
                agent.aware(Surroundings(step.link.connected, step.link.routed, rival=step.link.rival))
            inbox = [
                buffer[Title(keys[one.key], one.checksum)]._replace(
                    arrived=one.arrived, unverified=one.unverified, forged=one.forged
                )
                for one in step.received
                if keys[one.key] in self._receives
            ]
            for out in agent.act(step.now, inbox):
                if out.key == self._command:
                    yield out.payload
        if traced.halt is not None:
            yield next(iter(agent.halt(traced.halt, "as recorded"))).payload

    @property
    def _keys(self) -> tuple[str, ...]:
        return self._about.keys if self._about else ()

    def _inputs(self, traced: Traced) -> tuple[Input, ...]:
        steps = [step for step in traced.steps if isinstance(step, Step)]
        if not steps:
            return ()
        end = steps[-1].mono
        return tuple(Input(key, end - one.arrived) for key, one in traced.received(self._keys))

    def _read(self, payload: bytes) -> PublishedCommand | None:
        try:
            if self._mission.robots[self._robot].cmd_vel == "twist":
                twist = decode(Twist, payload)
                return PublishedCommand(twist.speed, twist.turn_rate, payload)
            stamped = decode(TwistStamped, payload)
            return PublishedCommand(stamped.speed, stamped.turn_rate, payload)
        except BadMessage:
            return None


def _missing(needed: Mapping[Title, float], buffer: MessageBuffer) -> str | None:
    missing = [title.key for title in needed if title not in buffer]
    return (
        f"a message on {missing[0]} that its agent received is missing in the recording" if missing else None
    )


def _named(mission: Mission, fingerprint: str) -> Mission:
    """`mission` with the recorded fingerprint, so that its messages are not of another mission."""
    named = mission.model_copy()
    named.__dict__["fingerprint"] = fingerprint  # where `cached_property` keeps it
    return named
