"""The traces of `formation.agent.persistence.trace`, read strictly: they may come from any file."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from formation.agent.persistence.trace import MAX_TRACED_INPUTS
from formation.protocol.order import MAX_REQUEST_BYTES
from formation.wire import Now

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
        many = sum(1 + len(step.received) if isinstance(step, Step) else 1 for step in traced.steps)
        if many > MAX_TRACED_INPUTS:  # an agent traces no more; each costs a step or a search
            raise BadTraceError(f"has {many} steps and messages, at most {MAX_TRACED_INPUTS} are read")
        return traced
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise BadTraceError(f"{where + ': ' if where else ''}{first['msg']}") from None
