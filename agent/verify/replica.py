"""An agent that repeats the traced steps of a recorded one, and the messages that it needs for that."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from formation.agent.core import Agent
from formation.agent.persistence.state import RESTORED, BadStateError, restore
from formation.agent.persistence.trace import (
    About,
    BadTraceError,
    RequestStep,
    RestoredStep,
    Step,
    Traced,
    checksum,
)
from formation.agent.status import Surroundings
from formation.control.laws import why_unusable
from formation.mission.model import Mission
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.topics import CMD_VEL
from formation.wire import BadMessage, Sample

MAX_STORED_TIME = 10.0
"""Longest time that a message may wait in a blocked agent's mailbox before a trace names it [s]."""
MAX_BYTES = 256 * 1024 * 1024
"""Most bytes of payload that are kept: ten seconds of 6,000 messages a second have 20 MB. Without this, a
recording with a stopped clock would be kept as a whole."""


class Title(NamedTuple):
    """Key by which a message is found."""

    key: str
    checksum: int


class MessageBuffer:
    """Messages by title. Those older than `MAX_STORED_TIME`, or in excess, are dropped."""

    def __init__(self) -> None:
        self._found: dict[Title, tuple[Sample, float]] = {}
        self._oldest: deque[tuple[float, Title]] = deque()
        self._bytes = 0

    def put(self, sample: Sample, moment: float) -> Title:
        """Store a message recorded at `moment` [s]; moments never go back."""
        while self._oldest and (self._oldest[0][0] < moment - MAX_STORED_TIME or self._bytes > MAX_BYTES):
            put, title = self._oldest.popleft()
            if self._found[title][1] == put:  # else the same message was repeated
                self._bytes -= _size(self._found.pop(title)[0])
        title = Title(sample.key, checksum(sample))
        if title not in self._found or self._found[title][1] < moment:
            self._oldest.append((moment, title))
        if title in self._found:
            self._bytes -= _size(self._found[title][0])
        self._bytes += _size(sample)
        self._found[title] = sample, moment
        return title

    def __contains__(self, title: Title) -> bool:
        return title in self._found

    def __getitem__(self, title: Title) -> Sample:
        return self._found[title][0]


def _size(sample: Sample) -> int:
    """Approximate size in memory [bytes]."""
    return 500 + len(sample.payload) + len(sample.attachment or b"")


class RecordedCommand(NamedTuple):
    """A recorded command, and its attachment."""

    traced: Traced
    payload: bytes
    wall: float
    """[s, system clock of the recorder]"""


class PublishedCommand(NamedTuple):
    """A command and its payload."""

    speed: float
    """[m/s]"""
    turn_rate: float
    """[rad/s]"""
    payload: bytes


class Input(NamedTuple):
    """A message that is an input of a command."""

    key: str
    age: float
    """Its age at the time of the command [s]."""


class Comparison(NamedTuple):
    """A recorded command and the one computed from the same inputs."""

    wall: float
    """When it was recorded [s, system clock of the recorder]."""
    number: int
    """Number of the command, by agent."""
    recorded: PublishedCommand | None
    """None if it is no command."""
    computed: PublishedCommand | None
    """None if this agent sends nothing, or fails."""
    decision: str
    """State of the computing agent, and its reason."""
    inputs: tuple[Input, ...]
    """Since the command before."""

    @property
    def exact(self) -> bool:
        """Whether they are the same to the last bit."""
        return (
            self.recorded is not None
            and self.computed is not None
            and self.recorded.payload == self.computed.payload
        )

    @property
    def off(self) -> tuple[float, float]:
        """Their difference [m/s; rad/s]; infinite if one is missing."""
        if self.recorded is None or self.computed is None:
            return float("inf"), float("inf")
        one, other = self.recorded, self.computed
        return abs(one.speed - other.speed), abs(one.turn_rate - other.turn_rate)


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
        if (why := why_unusable(law)) is not None:
            raise BadTraceError(why)
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
