"""One agent of today, made to live through what the traces of a recorded one say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from agent.core import Agent
from agent.memory import BadMemoryError, recall
from agent.status import Surroundings
from agent.verify.shelf import Shelf, Title
from agent.verify.traced import About, Asked, BadTraceError, Recalled, Step, Traced
from agent.verify.verdict import Comparison, Input, Told
from formation.law import LAWS
from formation.mission import Mission
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.topics import CMD_VEL
from formation.wire import BadMessage


class Said(NamedTuple):
    """A recorded command, and what rode on it."""

    traced: Traced
    payload: bytes
    wall: float
    """[s, system clock of the recorder]"""


class Replica:
    """Stands for one voice of one robot, from its start or from its next memory on."""

    def __init__(self, mission: Mission, robot: str, law: str | None, late: str) -> None:
        """Its law is the recorded agent's unless `law` says otherwise.

        `late` says why its beginning may be missing.
        """
        self._mission, self._robot, self._law, self._late = mission, robot, law, late
        self._command = CMD_VEL.key(robot)
        self._about: About | None = None
        self._number: int | None = None
        self._agent: Agent | None = None
        self._hears: frozenset[str] = frozenset()

    def needs(self, traced: Traced) -> dict[Title, float]:
        """What must be there to follow `traced`, and when it arrived; nothing if it cannot be followed.

        Raises BadTraceError.
        """
        about = traced.agent or self._about
        if about is None or self._broken(traced) or (self._agent is None and not self._begins(traced)):
            return {}
        return {Title(key, one.checksum): one.arrived for key, one in traced.heard(about.keys)}

    def follow(self, said: Said, shelf: Shelf) -> Comparison | str | None:
        """The recorded command beside our own; or why there can be none, None where that is known already.

        Raises BadTraceError.
        """
        traced = said.traced
        if self._number is not None and traced.n <= self._number:
            return "comes a second time"
        broken = self._broken(traced) or _missing(self.needs(traced), shelf)
        begins = self._begins(traced)
        self._number, self._about = traced.n, traced.agent or self._about
        result: Comparison | str | None = broken
        if broken:
            self._agent = None
        elif begins:
            self._agent = self._new_agent()
        if self._agent is not None:
            result = self._compared(self._agent, said, shelf)
        if self._agent is None and traced.memory is not None:
            failure = self._recall(traced)
            result = failure if failure and not isinstance(result, Comparison) else result
        return result

    def _begins(self, traced: Traced) -> bool:
        """Whether an agent that knows nothing yet can follow it."""
        return traced.n == 1 and self._number is None and traced.agent is not None

    def _broken(self, traced: Traced) -> str | None:
        """Why it does not follow from what was before; missing messages are another matter."""
        if traced.gap:
            return f"its steps are not told: {traced.gap}"
        if self._number is None:
            return None if traced.n == 1 else self._late
        missing = traced.n - self._number - 1
        if missing:
            return f"{missing} command{'' if missing == 1 else 's'} before it missing in the recording"
        return None

    def _new_agent(self) -> Agent:
        """Raises BadTraceError for a law that there is not."""
        about = self._about
        if about is None:
            raise BadTraceError("does not say what its agent was made with")
        law = self._law or about.law
        if law not in LAWS:
            raise BadTraceError(f"law {law!r}: must be one of {', '.join(LAWS)}")
        agent = Agent(_named(self._mission, about.mission), self._robot, law, readonly=about.readonly)
        self._hears = frozenset(agent.subscriptions)
        return agent

    def _recall(self, traced: Traced) -> str | None:
        """Know from here on what the recorded agent knew; why not, if that cannot be."""
        agent = self._new_agent()
        try:
            recall(agent, traced.memory)
        except Exception as bad:  # noqa: BLE001 - it may come from any file
            kind = "" if isinstance(bad, BadMemoryError) else f"{type(bad).__name__}: "
            return f"what its agent knew cannot be taken over: {kind}{bad}"
        self._agent = agent
        return None

    def _compared(self, agent: Agent, said: Said, shelf: Shelf) -> Comparison:
        failure = ""
        computed: list[bytes] = []
        try:
            computed.extend(self._live(agent, said.traced, shelf))
        except Exception as error:  # noqa: BLE001 - that today's agent fails is what we are here to find
            self._agent, failure = None, f"fails: {type(error).__name__}: {error}"
        return Comparison(
            said.wall,
            said.traced.n,
            self._read(said.payload),
            self._read(computed[0]) if len(computed) == 1 else None,
            failure or f"{agent.decision.state}: {agent.decision.reason}",
            self._inputs(said.traced),
        )

    def _live(self, agent: Agent, traced: Traced, shelf: Shelf) -> Iterator[bytes]:
        """Take the steps of `traced`; the commands that `agent` says in them. Whatever that raises."""
        keys = self._keys
        for step in traced.steps:
            if isinstance(step, Asked):
                agent.request(step.request.encode(), step.heard)
                continue
            if isinstance(step, Recalled):
                recall(agent, step.recalled, partly=True)
                continue
            if step.link is not None:
                agent.aware(Surroundings(step.link.connected, step.link.routed, rival=step.link.rival))
            inbox = [
                shelf[Title(keys[one.key], one.checksum)]._replace(
                    arrived=one.arrived, unverified=one.unverified, forged=one.forged
                )
                for one in step.heard
                if keys[one.key] in self._hears
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
        return tuple(Input(key, end - one.arrived) for key, one in traced.heard(self._keys))

    def _read(self, payload: bytes) -> Told | None:
        try:
            if self._mission.robots[self._robot].cmd_vel == "twist":
                twist = decode(Twist, payload)
                return Told(twist.speed, twist.turn_rate, payload)
            stamped = decode(TwistStamped, payload)
            return Told(stamped.speed, stamped.turn_rate, payload)
        except BadMessage:
            return None


def _missing(needed: Mapping[Title, float], shelf: Shelf) -> str | None:
    missing = [title.key for title in needed if title not in shelf]
    return f"a message on {missing[0]} that its agent heard is missing in the recording" if missing else None


def _named(mission: Mission, fingerprint: str) -> Mission:
    """`mission`, edited or not, under the fingerprint recorded: its messages are not another mission's."""
    named = mission.model_copy()
    named.__dict__["fingerprint"] = fingerprint  # where `cached_property` keeps it
    return named
