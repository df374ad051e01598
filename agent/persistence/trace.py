r"""Record, with each command, all inputs of the agent since the one before, so that a run can be repeated.

The trace is an attachment of `CMD_VEL` as published to the fleet. It names each message by key and checksum,
since the recording contains the messages, with its arrival and the clocks of each step; now and then it also
contains the agent's state, from which a recording that began later, or has lost something, can be continued.
`formation.agent.verify` repeats it. It is read strictly, as it may come from any file.

    {"n": 17, "publisher_id": "…",                   17th command of this publisher id
     "steps": [[mono, wall, [[key, crc, arrived], …]],          key: which of the agent's subscriptions
               (for an order that did not count besides: why, and whether it was forged)
               [mono, wall, […], [connected, routed, rival]],   the robot's side, where that has changed
               [received, "{\"do\": …}"],                       an operator's request, between two steps
               {"restored": {…}}],                              what it restored of the process before it
     "halt": [mono, wall],                           after these steps the agent sent its last messages
     "gap": "…",                                     instead of steps: why they are missing
     "agent": {"law": …, "readonly": …, "mission": …, "keys": […]}, "state": {…}}      after the command

It is made after the command has been sent to the robot, and its failures affect nothing else: a trace that
cannot be made is omitted and counted, and the next one contains the state.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, NamedTuple
from zlib import crc32

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from formation.agent.core import Agent
from formation.agent.persistence.state import RESTORED, Json, Restored, dump, explained
from formation.protocol.request import MAX_REQUEST_BYTES
from formation.ros2.messages import MAX_PAYLOAD_BYTES
from formation.ros2.ros_names import address
from formation.wire import Now, Sample

STATE_PERIOD = 5.0
"""[s]"""
RETRY_PERIOD = 1.0
"""Shortest time between two states if a trace failed [s]."""
MAX_TRACED_INPUTS = 400
"""Most messages, steps and requests traced between two commands; at 200 Hz there are a few."""
MAX_TRACE_BYTES = MAX_PAYLOAD_BYTES - 1024
"""Greatest size of a trace [bytes], so that a recording can store it."""
_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


Count = Annotated[int, Field(ge=0, lt=2**63)]
Text = Annotated[str, Field(max_length=1000)]


class BadTraceError(ValueError):
    """The attachment of a command is no trace; the text says why."""


class TracedMessage(NamedTuple):
    """A message of an inbox."""

    key: Count
    """Which of the agent's keys."""
    checksum: Count
    arrived: float
    """[s, monotonic]"""
    unverified: Text = ""
    """Why its order did not count."""
    forged: bool = False


class Link(NamedTuple):
    """State of the robot's side, as an agent saw it: the part of `Surroundings` that affects commands."""

    connected: bool | None
    routed: bool | None
    rival: bool = False


class Step(NamedTuple):
    """One step of an agent, or, with `link`, one at which its link with the robot had changed."""

    mono: float
    wall: float
    received: tuple[TracedMessage, ...]
    link: Link | None = None

    @property
    def now(self) -> Now:
        """The clocks of this step."""
        return Now(self.mono, self.wall)


class RequestStep(NamedTuple):
    """An operator's request, between two steps."""

    received: float
    """[s, monotonic]"""
    request: Annotated[str, Field(max_length=MAX_REQUEST_BYTES)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class RestoredStep(_Table):
    """State that an agent restored, between two steps, from another that ran before it."""

    restored: dict[Text, Any]


class About(_Table):
    """How an agent was constructed."""

    law: Text
    readonly: bool
    mission: Text
    """Fingerprint."""
    keys: tuple[Text, ...]
    """Keys that it subscribes to."""


class Traced(_Table):
    """One command's trace."""

    n: Count
    """Number of this command, from 1, by publisher id."""
    publisher_id: Text
    steps: tuple[Step | RequestStep | RestoredStep, ...] = ()
    """Its inputs since the command before: steps, and between them an operator's requests."""
    halt: Now | None = None
    """When the agent sent its last messages."""
    gap: Text = ""
    """Why the steps are missing."""
    agent: About | None = None
    state: Any = None
    """The agent's state after this command."""

    def received(self, keys: tuple[str, ...]) -> list[tuple[str, TracedMessage]]:
        """Every message that it names, with its key. Raises BadTraceError for a key not in `keys`."""
        found = [one for step in self.steps if isinstance(step, Step) for one in step.received]
        if any(one.key >= len(keys) for one in found):
            raise BadTraceError(f"names a key that the agent does not have: it has {len(keys)}")
        return [(keys[one.key], one) for one in found]


def read(attachment: bytes) -> Traced:
    """Parse the trace in an attachment. Raises BadTraceError, and nothing else."""
    try:
        traced = Traced.model_validate_json(attachment)
    except ValidationError as error:
        raise BadTraceError(explained(error)) from None
    many = sum(1 + len(step.received) if isinstance(step, Step) else 1 for step in traced.steps)
    if many > MAX_TRACED_INPUTS:  # an agent traces no more; each costs a step or a search
        raise BadTraceError(f"has {many} steps and messages, at most {MAX_TRACED_INPUTS} are read")
    return traced


class Trace:
    """The inputs of one agent since its newest command."""

    def __init__(self, agent: Agent) -> None:
        self.failures = 0
        """Number of traces that could not be made."""
        self.failure = ""
        """Why the newest of them failed."""
        self._agent = agent
        self._about = {
            "law": agent.controller.name,
            "readonly": agent.readonly,
            "mission": agent.mission.fingerprint,
            "keys": agent.subscriptions,
        }
        self._publisher_id = agent.publisher_id
        self._numbers = {key: number for number, key in enumerate(agent.subscriptions)}
        self._count = 0
        self._link: Link | None = Link(None, None)  # as last traced
        self._steps: list[Json] = []
        self._room = MAX_TRACED_INPUTS
        self._halt: Now | None = None
        self._gap = ""
        self._mono = 0.0  # of the newest step
        self._state_traced = float("-inf")  # [s, monotonic]

    def stepped(self, now: Now, link: Link, received: Sequence[Sample]) -> None:
        """Record a step. Never raises."""
        try:
            self._mono = now.mono
            if not self._makes_room(1 + len(received)):
                return
            step: list[Json] = [now.mono, now.wall, [self._named(sample) for sample in received]]
            if link != self._link:
                self._link = link
                step.append(link)
            self._steps.append(step)
        except Exception as error:  # noqa: BLE001 - whatever it is, the agent drives on
            self._fail(error)

    def requested(self, request: bytes, received: float) -> None:
        """Record an operator's request at `received` [s, monotonic]. Never raises."""
        try:  # a request that is too long or no text is refused, and does not affect commands
            if len(request) <= MAX_REQUEST_BYTES and self._makes_room(1):
                self._steps.append([received, request.decode()])
        except UnicodeDecodeError:
            return
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)

    def restored(self, restored: Restored) -> None:
        """Record the state that the agent restored from an earlier one. Never raises."""
        try:
            if self._makes_room(1):
                self._steps.append({"restored": RESTORED.write(restored)})
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)

    def halted(self, now: Now) -> None:
        """Record that the agent sends its last messages."""
        self._mono, self._halt = now.mono, now

    def attachment(self) -> bytes | None:
        """The trace of the newest command; None if it cannot be made. Never raises."""
        self._count += 1
        for _ in range(2):  # if the steps fail, a trace with the gap instead
            try:
                trace = self._text().encode()
            except Exception as error:  # noqa: BLE001 - as above
                self._fail(error)
            else:
                self._steps, self._room, self._halt, self._gap = [], MAX_TRACED_INPUTS, None, ""
                return trace
        return None

    def _text(self) -> str:
        fields: dict[str, Json] = {"n": self._count, "publisher_id": self._publisher_id}
        fields |= {"gap": self._gap} if self._gap else {"steps": self._steps}
        if self._halt is not None:
            fields["halt"] = self._halt
        if self._mono - self._state_traced < (RETRY_PERIOD if self._gap else STATE_PERIOD):
            return _within(MAX_TRACE_BYTES, _encode(fields))
        self._state_traced = self._mono
        text = _within(MAX_TRACE_BYTES, _encode({**fields, "agent": self._about}))
        try:
            return _within(MAX_TRACE_BYTES, f'{text[:-1]},"state":{_encode(dump(self._agent))}}}')
        except Exception as error:  # noqa: BLE001 - the steps may still be written
            self._count_failure(error)
            return text

    def _named(self, sample: Sample) -> list[Json]:
        if len(sample.payload) + len(sample.attachment or b"") > MAX_PAYLOAD_BYTES:
            raise ValueError(f"a message on {sample.key} is longer than any that is read")
        named: list[Json] = [self._numbers[sample.key], checksum(sample), sample.arrived]
        return [*named, sample.unverified, sample.forged] if sample.unverified else named

    def _makes_room(self, entries: int) -> bool:
        self._room -= entries
        if self._room < 0 and not self._gap:
            self._begin_anew(f"more than {MAX_TRACED_INPUTS} messages between two commands")
        return not self._gap

    def _fail(self, error: Exception) -> None:
        self._count_failure(error)
        self._begin_anew(f"could not be recorded: {self.failure}")

    def _begin_anew(self, gap: str) -> None:
        """Replace the steps so far by the reason `gap`; the link is then traced even if unchanged."""
        self._steps, self._link, self._gap = [], None, gap

    def _count_failure(self, error: Exception) -> None:
        self.failures += 1
        self.failure = str(error)[:200] or type(error).__name__


def checksum(sample: Sample) -> int:
    """Return the checksum by which a message is found among those on its key.

    Attachments count only between robots: on a robot ROS decides what they are, and they are not repeated.
    """
    found = crc32(sample.payload)
    if sample.attachment is None or not _between_robots(sample.key):
        return found
    return crc32(sample.attachment, found)


@cache
def _between_robots(key: str) -> bool:
    return address(key).topic.side == "fleet"


def _within(longest: int, text: str) -> str:
    if len(text) > longest:
        raise ValueError(f"{len(text)} bytes, at most {longest} are recorded")
    return text
