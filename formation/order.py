"""The order that travels with the positions, and the operator's request.

The leader writes an order on its own position; every agent relays the newest it has seen, unchanged, on its
own position, so along the spanning tree it reaches everyone. Its `beat` counts the leader's periods: as long
as it rises, the leader lives.

What is attached to a position also says whose voice that is (`Told`), so that a second process which speaks
for the same robot, or a recording of the first, is told apart.

In a mission with certificates the leader signs each order. The order then travels as the very text that was
signed, beside its signature, so that every robot verifies the bytes that it decodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError, to_json

from formation.legs import Leg
from formation.tables import as_tuple
from formation.wire import BadMessage

MAX_BYTES = 1024
"""Longest order, reply or ballot that is read at all."""

MAX_REQUEST = 16_384
"""Longest request: it may carry a route [bytes]."""

LEADER_LOST = 1.0
"""Silence of the leader's beat after which it counts as gone, and everybody stands still [s]."""

LONGEST_REASON = 400
"""It may name some robots, of up to 64 each [characters]."""
ROOM = MAX_BYTES - 200
"""For the reason, of a reply [bytes]."""

Mode = Literal["hold", "run", "stop"]
Do = Literal["hold", "run", "stop", "release", "shape", "rotate", "scale", "speed", "route", "tune", "query"]
MAX_ENDED = 200
"""Most stops and holds that one request may end."""
Code = Literal["", "no-link", "no-listener", "readonly", "nothing", "unnamed", "another", "stopped"]
"""What a program needs to know of an answer; empty: nothing besides whether it obeys.

``no-link``, ``no-listener``, ``readonly``: a stop or a hold is latched, and cannot reach the robot;
``nothing``: there was nothing to release; ``unnamed``: a release or a run must name what it ends;
``another``: it names another stop or hold than the one in force; ``stopped``: refused while stopped.
"""
UNREACHED: frozenset[Code] = frozenset({"no-link", "no-listener", "readonly"})
"""The robot itself is out of reach of whoever answers."""
Count = Annotated[int, Field(ge=0, lt=2**63)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")]
Voice = Annotated[str, StringConstraints(max_length=64, pattern=r"^[A-Za-z0-9_.-]*$")]
Tag = Annotated[str, StringConstraints(max_length=16, pattern=r"^[A-Za-z0-9]*$")]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Scale = Annotated[float, Field(allow_inf_nan=False, ge=1e-3, le=1e3)]
Share = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1.0)]
LEAST_GAIN, MOST_GAIN = 1e-3, 1e3
"""A gain that can be ordered is between these; k_i may also be 0."""
Proportional = Annotated[float, Field(allow_inf_nan=False, ge=LEAST_GAIN, le=MOST_GAIN)]
Integral = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=MOST_GAIN)]


Legs = Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1, max_length=500)]


class _Json(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")
    longest: ClassVar[int] = MAX_BYTES
    read_twice: ClassVar[bool] = False
    """Whether it may be verified as it arrives, and read again in a step."""

    def opened(self) -> Self:
        """With what is packed in it as text as well. Raises ValidationError."""
        return self


class Slots(_Json):
    """Where slots are while they are on their way, or turn: `formation.figure.Figure`."""

    mix: dict[Name, Share] = Field(min_length=1, max_length=8)
    """Each shape's share; they sum to 1."""
    rotation: Number = 0.0
    """Counter-clockwise [rad; world frame]."""
    scale: Scale = 1.0


class Place(_Json):
    """Where the leader is."""

    x: Number
    y: Number
    """[m; world frame]"""
    heading: Number
    """Direction of travel [rad; world frame]."""


class Tuned(_Json):
    """Gains of the law, in the place of the mission's."""

    k_p: Proportional
    """[1/s]"""
    k_i: Integral
    """[1/s²]"""

    @property
    def words(self) -> str:
        """``k_p = 2, k_i = 1``."""
        return f"k_p = {self.k_p:g}, k_i = {self.k_i:g}"


Refusal = Literal["ahead", "earlier"]
"""Why a term is refused: it begins over a day from now, or a later one is in force."""


class Order(_Json):
    """What the leader wants of the team, and all that a successor needs to go on from here."""

    term: Count
    """Of whom it is: a new leader outranks the old one. [ns] of its system clock or a little more, see
    `formation.election`."""
    beat: Count
    """Counts the leader's periods within its term."""
    mode: Mode
    shape: Name
    """Name of the mission's shape to hold."""
    rotation: Number = 0.0
    """By which the shape is to be turned, as it is drawn or from the leader's heading [rad]."""
    scale: Scale = 1.0
    """By which it is to be larger than it is drawn."""
    slots: Slots | None = None
    """Where the slots are by now; None: in `shape`, `rotation` and `scale`."""
    told: Literal["hold", "run"] = "run"
    """What is in force once nothing is left to release."""
    holding: bool = False
    """Whether a hold is to be released before that."""
    route: Voice = ""
    """Which route the leader is on; empty for the mission's own."""
    time: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    """How long it has been on it [s]."""
    place: Place | None = None
    """Where it is."""
    tuned: Tuned | None = None
    """Gains that everybody is to have; None for the mission's."""


Base64 = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]*$")]
MAX_SIGNED_BYTES, MAX_SIGNATURE, MAX_CERTIFICATE = 800, 128, 900
"""Longest signed order [bytes], signature and certificate [characters of Base64] that are read."""


class Told(_Json):
    """What is attached to a position: who speaks, and the newest order that is known there.

    `decode` fills `order` from `signed` where that is given; whether the signature is right it does not say.
    """

    read_twice: ClassVar[bool] = True

    voice: Voice
    """Drawn anew whenever a process starts; all that it says has the same."""
    count: Count
    """Positions told by this voice so far: what was said before cannot be said again."""
    order: Order | None = None
    signed: Annotated[str, StringConstraints(max_length=MAX_SIGNED_BYTES)] = ""
    """The order as the JSON text that its leader signed; empty where orders are not signed."""
    signature: Annotated[Base64, StringConstraints(max_length=MAX_SIGNATURE)] = ""
    """Of `signed`, as `formation.transport.signing` makes it."""
    certificate: Annotated[Base64, StringConstraints(max_length=MAX_CERTIFICATE)] = ""
    """Of a candidate (X.509, DER). For lack of room it goes in the order's place, about once a second."""
    term: Count = 0
    """Of the order that a certificate has displaced; 0 otherwise."""
    aside: bool = False
    """It does not follow, or not closely yet: who has another neighbour is better off without it."""
    promise: Count = 0
    """Newest term that it has promised its voice to; where there are standbys."""
    echo: Count = 0
    """Newest ballot of that term that it has heard."""
    mission: Tag = ""
    """Tag of the mission that the sender runs; empty: unknown, which is another one."""
    refused: Count = 0
    """Newest term that it has refused in the last seconds; 0 for none."""
    because: Refusal | None = None
    """Why it has."""

    def opened(self) -> Self:
        """With the order that was signed, in the place of any other."""
        if not self.signed:
            return self
        return self.model_copy(update={"order": _signed_order(self.signed)})


@lru_cache(64)
def _signed_order(text: str) -> Order:
    """An order that was signed: read once, however many neighbours relay it. Raises ValidationError."""
    return Order.model_validate_json(text)


class Ballot(_Json):
    """Asks every follower for its voice in a term, and keeps it: see `formation.election`."""

    term: Count
    number: Count
    """Counts the ballots of a term."""
    standing: Literal["candidate", "leader", "leaving"]
    """``leaving``: whoever promised this term is free at once."""
    mission: Tag = ""
    """As with a position."""


class OperatorRequest(_Json):
    """What an operator asks of one robot.

    ``release`` ends a stop, after which the robot holds; ``run`` ends a hold. Both name what they end.
    ``query`` changes nothing: the answer has the ids of the stop and the hold in force.
    """

    longest: ClassVar[int] = MAX_REQUEST
    do: Do
    shape: Name | None = None
    """Which one the team is to take; with ``shape``, and with nothing else."""
    degrees: Annotated[float, Field(ge=-3600.0, le=3600.0, allow_inf_nan=False)] | None = None
    """With ``rotate``: by how much the shape is to be turned from how it is drawn, counter-clockwise. With
    ``speed``: where to, as a mission's ``heading_deg``."""
    factor: Scale | None = None
    """With ``scale``: by how much the shape is to be larger than it is drawn."""
    speed: Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False)] | None = None
    """With ``speed``: of the leader, from where it is [m/s]."""
    legs: (
        Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1, max_length=500)] | None
    ) = None
    """With ``route``: where the leader is to go from where it is."""
    k_p: Proportional | None = None
    """With ``tune``: the law's proportional gain [1/s]; without it that stays as it is."""
    k_i: Integral | None = None
    """With ``tune``: the law's integral gain [1/s²], likewise."""
    ends: Annotated[tuple[Name, ...], BeforeValidator(as_tuple), Field(max_length=MAX_ENDED)] = ()
    """With ``release`` and ``run``: ids of the stops or holds that it ends. Any other stays in force."""
    id: Voice = ""
    """Of one order, however often it is put: a repetition takes no effect a second time. Empty: unknown."""
    age: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """Since it was put for the first time [s]. A stop or a hold of age 0 is new, whatever its id."""

    @property
    def spelled(self) -> dict[str, Any]:
        """All that is given of it, for JSON."""
        return self.model_dump(mode="json", exclude_none=True, exclude=None if self.ends else {"ends"})

    @model_validator(mode="after")
    def _whole(self) -> Self:
        takes = TAKES.get(self.do, ())
        given = tuple(name for name in PARTS if getattr(self, name) is not None)
        some = self.do == "tune" and bool(given) and set(given) < set(takes)
        if self.ends and self.do not in {"release", "run"}:
            raise PydanticCustomError("ends", f"{self.do} ends nothing: only release and run do")
        if not some and set(given) != set(takes):
            wanted = (" or " if self.do == "tune" else " and ").join(takes) or "nothing"
            raise PydanticCustomError("takes", f"{self.do} takes {wanted}")
        return self


TAKES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "shape": ("shape",),
        "rotate": ("degrees",),
        "scale": ("factor",),
        "speed": ("speed", "degrees"),
        "route": ("legs",),
        "tune": ("k_p", "k_i"),
    }
)
"""What belongs to a request, all of it (with ``tune``, any); nothing to those that are not here."""
PARTS = tuple(dict.fromkeys(name for takes in TAKES.values() for name in takes))
"""All of these."""


class OperatorReply(_Json):
    """One robot's answer: whether it obeys, the mode it is now in, and why."""

    robot: Name
    ok: bool
    mode: Mode
    reason: Annotated[str, StringConstraints(max_length=LONGEST_REASON)] = ""
    leads: bool | None = None
    """Whether it is in charge; None for who never is."""
    code: Code = ""
    """What a program needs to know."""
    stop: Voice = ""
    """To a ``query``: id of the stop in force; empty for none."""
    hold: Voice = ""
    """To a ``query``: id of the hold in force, below a stop too; empty for none."""


FORGED_ORDER = "forged order "
"""In a status the values about robots that relay what no leader gave are called so, and the robot's name."""


def statement(fingerprint: str, text: str) -> bytes:
    """What a candidate signs for an order with this text, in the mission with this fingerprint."""
    return f"formation order\n{fingerprint}\n{text}".encode()


J = TypeVar("J", Order, Told, Ballot, OperatorRequest, OperatorReply)


def newer(a: Order, b: Order | None) -> bool:
    """Whether `a` supersedes `b`: a later term, or a later beat of the same term. Any supersedes None."""
    return b is None or (a.term, a.beat) > (b.term, b.beat)


def mixed(sender: str, theirs: str, ours: str) -> str:
    """What an operator reads of a sender that runs another mission; `theirs` and `ours` are tags."""
    other = f"mission {theirs}" if theirs else "an unknown mission"
    return f"{sender} runs {other}, this process {ours}: give all the same one (formation deploy push)"


def check_mission(sender: str, theirs: str, ours: str) -> None:
    """Raise BadMessage for a message of another mission than `ours`; both are tags."""
    if theirs != ours:
        raise BadMessage(mixed(sender, theirs, ours))


def encode(value: Order | Told | Ballot | OperatorRequest | OperatorReply) -> bytes:
    """JSON, UTF-8; what is as it always was is left out, so that older robots understand a stop."""
    given = {"order"} if isinstance(value, Told) and value.signed else None
    return value.model_dump_json(exclude_defaults=True, exclude=given).encode()


def shortened(reason: str) -> str:
    """As much of a reason as a reply has room for. What is cut says so: half a number is a wrong one."""
    said = reason if len(reason) <= LONGEST_REASON else f"{reason[: LONGEST_REASON - 1]}…"
    while len(to_json(said)) > ROOM:  # what is no ASCII takes more than a byte
        said = f"{said[:-2]}…"
    return said


def _read(cls: type[J], data: bytes) -> J:
    return cls.model_validate_json(data).opened()


_read_once = lru_cache(64)(_read)
"""What was read to be verified, on the receive thread, is not read again in a step."""


def decode(cls: type[J], data: bytes) -> J:
    """Read `data` strictly. Raises BadMessage, and nothing else, for anything that is not exactly a `cls`."""
    if len(data) > cls.longest:
        raise BadMessage(f"{cls.__name__}: {len(data)} bytes, at most {cls.longest} are read")
    try:
        return _read_once(cls, data) if cls.read_twice else _read(cls, data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadMessage(f"{cls.__name__}: {where + ': ' if where else ''}{first['msg']}") from None
