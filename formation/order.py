"""The order that travels with the positions, and the operator's request.

The leader writes an order on its own position; every agent relays the newest it has seen, unchanged, on its
own position, so along the spanning tree it reaches everyone. Its `beat` counts the leader's periods: as long
as it rises, the leader lives.

What is attached to a position also says whose voice that is (`Told`), so that a second process which speaks
for the same robot, or a recording of the first, is told apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from formation.wire import BadMessage

MAX_BYTES = 1024
"""Longest order, request or reply that is read at all."""

LEADER_LOST = 1.0
"""Silence of the leader's beat after which it counts as gone, and everybody stands still [s]."""

REMEMBERED = 64
"""So many requests are known when they are put again."""

RESTS = frozenset({"stop", "hold"})
"""What brings robots to rest."""

STEPS = 0.25
"""Who is asked knows the time by its newest step, which may be so old [s]."""

LONGEST_REASON = 120
"""[characters]"""

Mode = Literal["hold", "run", "stop"]
Do = Literal["hold", "run", "stop", "release", "shape"]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")]
Voice = Annotated[str, StringConstraints(max_length=64, pattern=r"^[A-Za-z0-9_.-]*$")]


class _Json(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class Order(_Json):
    """What the leader wants of the team."""

    term: Count
    """When this leader took over [ns, its system clock]: a new leader outranks the old one."""
    beat: Count
    """Counts the leader's periods within its term."""
    mode: Mode
    shape: Name
    """Name of the mission's shape to hold."""


class Told(_Json):
    """What is attached to a position: who speaks, and the newest order that is known there."""

    voice: Voice
    """Drawn anew whenever a process starts; all that it says has the same."""
    count: Count
    """Positions told by this voice so far: what was said before cannot be said again."""
    order: Order | None = None


class OperatorRequest(_Json):
    """What an operator asks of one robot. ``release`` ends a stop or hold that the operator asked for."""

    do: Do
    shape: Name | None = None
    """Which one the team is to take; with ``shape``, and with nothing else."""
    id: Voice = ""
    """Of one order, however often it is put: a repetition takes no effect a second time. Empty: unknown."""
    age: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """Since it was put for the first time [s]."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.do == "shape") != (self.shape is not None):
            raise PydanticCustomError("shape", "a shape belongs to the order 'shape', and to no other")
        return self


class OperatorReply(_Json):
    """One robot's answer: whether it obeys, the mode it is now in, and why."""

    robot: Name
    ok: bool
    mode: Mode
    reason: Annotated[str, StringConstraints(max_length=LONGEST_REASON)] = ""


class Once:
    """Obeys each request once, and none that a stop or a hold has overtaken.

    Operators repeat theirs until all have answered. A release that is put again must undo neither the hold
    below the stop nor a stop that came meanwhile; and one that was put before a stop, and is heard after it,
    was meant for something else.
    """

    def __init__(self) -> None:
        self.now = float("-inf")
        """When the newest step was [s, monotonic]."""
        self._rested = float("-inf")  # when a stop or a hold was heard last; infinite: since the newest step
        self._answers: dict[str, bytes] = {}

    def aware(self, mono: float) -> None:
        """A step is taken [s, monotonic]. What was heard since the one before counts as heard only now.

        Before the first step nobody knows the time, and after one that took long nobody knows it well: a stop
        that was heard then must not be taken for an older one than it is.
        """
        self.now, self._rested = mono, min(self._rested, mono)

    def answer(
        self, request: OperatorRequest, obey: Callable[[], bytes], refuse: Callable[[str], bytes]
    ) -> bytes:
        """What ``obey()`` answers, or answered to the same request before; ``refuse(why)`` if overtaken."""
        if request.id in self._answers:
            return self._answers[request.id]
        overtaken = self._overtaken(request)
        reply = refuse("asked for before the newest stop or hold: ask again") if overtaken else obey()
        if request.id:
            self._answers[request.id] = reply
            if len(self._answers) > REMEMBERED:
                self._answers.pop(next(iter(self._answers)))
        return reply

    def _overtaken(self, request: OperatorRequest) -> bool:
        if request.do in RESTS:
            self._rested = float("inf")
            return False
        return request.age > 0.0 and self.now - self._rested < request.age + STEPS


J = TypeVar("J", Order, Told, OperatorRequest, OperatorReply)


def newer(a: Order, b: Order | None) -> bool:
    """Whether `a` supersedes `b`: a later term, or a later beat of the same term. Any supersedes None."""
    return b is None or (a.term, a.beat) > (b.term, b.beat)


def encode(value: Order | Told | OperatorRequest | OperatorReply) -> bytes:
    """JSON, UTF-8; what is as it always was is left out, so that older robots understand a stop."""
    return value.model_dump_json(exclude_defaults=True).encode()


def decode(cls: type[J], data: bytes) -> J:
    """Read `data` strictly. Raises BadMessage, and nothing else, for anything that is not exactly a `cls`."""
    if len(data) > MAX_BYTES:
        raise BadMessage(f"{cls.__name__}: {len(data)} bytes, at most {MAX_BYTES} are read")
    try:
        return cls.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadMessage(f"{cls.__name__}: {where + ': ' if where else ''}{first['msg']}") from None
