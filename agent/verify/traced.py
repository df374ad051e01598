"""What `agent.trace` tells, read strictly: it may come from any file."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from agent.trace import MOST
from formation.order import MAX_REQUEST
from formation.wire import Now

Count = Annotated[int, Field(ge=0, lt=2**63)]
Text = Annotated[str, Field(max_length=1000)]


class BadTraceError(ValueError):
    """What rides on a command is no trace; the text says why."""


class Heard(NamedTuple):
    """A message of an inbox."""

    key: Count
    """Which of the agent's keys."""
    checksum: Count
    arrived: float
    """[s, monotonic]"""
    unverified: Text = ""
    """Why the order on it did not count."""
    forged: bool = False


class Link(NamedTuple):
    """What an agent saw of its robot's side: of `agent.status.Surroundings` what commands depend on."""

    connected: bool | None
    routed: bool | None
    rival: bool = False


class Step(NamedTuple):
    """One step of an agent, or, with `link`, one at which its link with the robot had changed."""

    mono: float
    wall: float
    heard: tuple[Heard, ...]
    link: Link | None = None

    @property
    def now(self) -> Now:
        """By which clocks it was taken."""
        return Now(self.mono, self.wall)


class Asked(NamedTuple):
    """An operator's request, between two steps."""

    heard: float
    """[s, monotonic]"""
    request: Annotated[str, Field(max_length=MAX_REQUEST)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Recalled(_Table):
    """What an agent took over, between two steps, from another that ran before it."""

    recalled: dict[Text, Any]


class About(_Table):
    """What an agent was made with."""

    law: Text
    readonly: bool
    mission: Text
    """Fingerprint."""
    keys: tuple[Text, ...]
    """What it listens to."""


class Traced(_Table):
    """One command's trace."""

    n: Count
    """Which command of this voice, from 1."""
    voice: Text
    steps: tuple[Step | Asked | Recalled, ...] = ()
    """What led to it since the command before: steps, and between them an operator's requests."""
    halt: Now | None = None
    """When the agent said its last words."""
    gap: Text = ""
    """Why the steps are not told."""
    agent: About | None = None
    memory: Any = None
    """What the agent knew after this command."""

    def heard(self, keys: tuple[str, ...]) -> list[tuple[str, Heard]]:
        """Every message that it names, with its key. Raises BadTraceError for one that is none of `keys`."""
        found = [one for step in self.steps if isinstance(step, Step) for one in step.heard]
        if any(one.key >= len(keys) for one in found):
            raise BadTraceError(f"names a key that the agent does not have: it has {len(keys)}")
        return [(keys[one.key], one) for one in found]


def read(attachment: bytes) -> Traced:
    """The trace in an attachment. Raises BadTraceError, and nothing else."""
    try:
        traced = Traced.model_validate_json(attachment)
        many = sum(1 + len(step.heard) if isinstance(step, Step) else 1 for step in traced.steps)
        if many > MOST:  # an agent tells no more; each costs a step or a search
            raise BadTraceError(f"tells {many} steps and messages, at most {MOST} are read")
        return traced
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise BadTraceError(f"{where + ': ' if where else ''}{first['msg']}") from None
