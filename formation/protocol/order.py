"""The leader's order, attached to positions, and the operator's request.

The leader attaches an order to its own position; every agent relays the newest it has received, unchanged,
on its own position, so along the spanning tree it reaches all robots. Its `beat` counts the leader's
periods: as long as it rises, the leader is alive.

`PositionAttachment`, the attachment of a position, also contains the publisher id, so that a second
process of the same robot, or a recording of the first, is recognised.

In a mission with certificates the leader signs each order. The order is then transmitted as the very text
that was signed, with its signature, so that every robot verifies the bytes that it decodes.
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

from formation.control.plane import rotation
from formation.control.unicycle import along
from formation.mission.route import Leg
from formation.mission.tables import as_tuple
from formation.protocol.reasons import Code as ReasonCode
from formation.protocol.reasons import Reason
from formation.wire import BadMessage

MAX_ORDER_BYTES = 1024
"""Greatest size of an order, reply or ballot that is read."""

MAX_REQUEST_BYTES = 16_384
"""Greatest size of a request: it may contain a route [bytes]."""

LEADER_TIMEOUT_SECONDS = 1.0
"""Silence of the leader's beat after which it counts as dead, and all robots stand still [s]."""

DRIVE_TIMEOUT_SECONDS = 0.3
"""Time for which a driver's velocity counts, from the reply of the leader that it answers [s]."""

MAX_MOTION_SECONDS = 1.0
"""Longest time by which the leader's velocity is told ahead, and extrapolated [s]."""

MAX_REASON_CHARS = 400
"""Greatest length of a reason, which may name some robots of up to 64 each [characters]."""
MAX_REPLY_REASON_BYTES = MAX_ORDER_BYTES - 200
"""Space for the reason in a reply [bytes]."""

Mode = Literal["hold", "run", "stop"]
Do = Literal[
    "hold", "run", "stop", "release", "shape", "rotate", "scale", "speed", "route", "drive", "tune", "query"
]
MAX_ENDED = 200
"""Most stops and holds that one request may end."""
Code = Literal[
    "",
    "no-link",
    "no-listener",
    "readonly",
    "nothing",
    "unnamed",
    "another",
    "stopped",
    "first",
    "other-mission",
]
"""Code of an answer, for programs; empty: only whether it obeys.

``no-link``, ``no-listener``, ``readonly``: a stop or a hold is latched, and cannot reach the robot;
``nothing``: there was nothing to release; ``unnamed``: a release or a run must name what it ends;
``another``: it names another stop or hold than the one in force; ``stopped``: refused while stopped;
``first``: a driver's first request, which only fetches a token; ``other-mission``: it runs another mission
than the request's.
"""
UNREACHED: frozenset[Code] = frozenset({"no-link", "no-listener", "readonly"})
"""Codes of an agent that cannot reach its robot."""
Count = Annotated[int, Field(ge=0, lt=2**63)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")]
Id = Annotated[str, StringConstraints(max_length=64, pattern=r"^[A-Za-z0-9_.-]*$")]
Tag = Annotated[str, StringConstraints(max_length=16, pattern=r"^[A-Za-z0-9]*$")]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Scale = Annotated[float, Field(allow_inf_nan=False, ge=1e-3, le=1e3)]
Share = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1.0)]
MIN_GAIN, MAX_GAIN = 1e-3, 1e3
"""Bounds of a gain that can be ordered; k_i may also be 0."""
Proportional = Annotated[float, Field(allow_inf_nan=False, ge=MIN_GAIN, le=MAX_GAIN)]
Velocity = Annotated[float, Field(allow_inf_nan=False, ge=-1e3, le=1e3)]
Integral = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=MAX_GAIN)]


Legs = Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1, max_length=500)]


class _Json(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")
    longest: ClassVar[int] = MAX_ORDER_BYTES
    read_twice: ClassVar[bool] = False
    """Whether it may be verified as it arrives, and read again in a step."""

    def opened(self) -> Self:
        """Decode the parts that are packed as text. Raises ValidationError."""
        return self


class Slots(_Json):
    """Slots during a transition or a rotation: `formation.slots.shape.PlacedShape`."""

    mix: dict[Name, Share] = Field(min_length=1, max_length=8)
    """Each shape's share; they sum to 1."""
    rotation: Number = 0.0
    """Counter-clockwise [rad; world frame]."""
    scale: Scale = 1.0


class Place(_Json):
    """The leader's position."""

    x: Number
    y: Number
    """[m; world frame]"""
    heading: Number
    """Direction of travel [rad; world frame]."""


class Steady(_Json):
    """A velocity that turns at an even rate."""

    x: Number
    y: Number
    """[m/s; world frame]"""
    turn_rate: Number = 0.0
    """[rad/s]"""

    def after(self, time: float) -> complex:
        """Velocity [m/s; world frame] `time` [s] later."""
        return complex(self.x, self.y) * rotation(self.turn_rate * time)


class Motion(Steady):
    """The leader's velocity from its newest step on, and its next change."""

    until: Annotated[float, Field(ge=0.0, le=MAX_MOTION_SECONDS)] = 0.0
    """Time until that change [s]."""
    then: Steady | None = None
    """Velocity from then on; None if it does not change within `MAX_MOTION_SECONDS`."""

    def after(self, time: float) -> complex:
        """Velocity [m/s; world frame] `time` [s] after the step."""
        if self.then is not None and time >= self.until:
            return self.then.after(time - self.until)
        return super().after(time)

    def moved(self, time: float) -> complex:
        """How far the leader has moved `time` [s] after the step [m; world frame]."""
        if self.then is None or time <= self.until:
            return _moved(self, time)
        return _moved(self, self.until) + _moved(self.then, time - self.until)


def _moved(steady: Steady, time: float) -> complex:
    way, _ = along(0j, complex(steady.x, steady.y), time, steady.turn_rate * time)
    return way


class Tuned(_Json):
    """Gains of the law that replace the mission's."""

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
    """The leader's order to the fleet, with all that a successor needs to continue."""

    term: Count
    """Term of its leader: a later term replaces an earlier one. [ns] of its system clock or a little more,
    see `formation.protocol.election`."""
    beat: Count
    """Counts the leader's periods within its term."""
    mode: Mode
    shape: Name
    """Name of the mission's shape to hold."""
    rotation: Number = 0.0
    """Rotation of the shape, from its drawing or from the leader's heading [rad]."""
    scale: Scale = 1.0
    """Scale of the shape."""
    slots: Slots | None = None
    """Present slots; None: those of `shape`, `rotation` and `scale`."""
    base_mode: Literal["hold", "run"] = "run"
    """Mode that is in force once nothing is left to release."""
    holding: bool = False
    """Whether a hold is to be released before that."""
    route: Id = ""
    """Id of the leader's route; empty for the mission's own."""
    time: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    """Time since it began that route [s]."""
    place: Place | None = None
    """Its position."""
    motion: Motion | None = None
    """Its velocity; None while it stands, and where robots do not use it."""
    tuned: Tuned | None = None
    """Gains for all robots; None for the mission's."""
    driven: bool = False
    """Whether the leader is driven by hand: its beat then counts for `DRIVE_TIMEOUT_SECONDS` only."""

    @property
    def timeout(self) -> float:
        """Silence of its beat after which robots hold [s]."""
        return DRIVE_TIMEOUT_SECONDS if self.driven and self.mode == "run" else LEADER_TIMEOUT_SECONDS


Base64 = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]*$")]
MAX_SIGNED_BYTES, MAX_SIGNATURE_CHARS, MAX_CERTIFICATE_CHARS = 800, 128, 900
"""Greatest sizes of a signed order [bytes], signature and certificate [characters of Base64]."""


class ReceivedPosition(_Json):
    """The newest position of another robot that a robot has received."""

    robot: Name
    stamp: Annotated[float, Field(allow_inf_nan=False)]
    """Of that position [s, the other robot's clock]."""


MAX_ATTACHMENT_BYTES = 1280
"""Greatest size of a `PositionAttachment` that is read."""


class PositionAttachment(_Json):
    """The attachment of a position: its publisher id, and the newest order known there.

    `decode` fills `order` from `signed` if that is given; it does not verify the signature.
    """

    longest: ClassVar[int] = MAX_ATTACHMENT_BYTES
    read_twice: ClassVar[bool] = True

    publisher_id: Id
    """Publisher id, new at each start of a process; the same in all its messages."""
    count: Count
    """Number of positions with this publisher id so far: earlier messages cannot be repeated."""
    order: Order | None = None
    order_age: Annotated[float, Field(ge=0.0, le=MAX_MOTION_SECONDS)] = 0.0
    """Time from the leader's step to this message [s], as far as its relays know."""
    stale: bool = False
    """Whether the beat of `order` has not risen at the sender for `formation.protocol.election.expiry`."""
    signed: Annotated[str, StringConstraints(max_length=MAX_SIGNED_BYTES)] = ""
    """The order as the JSON text that its leader signed; empty where orders are not signed."""
    signature: Annotated[Base64, StringConstraints(max_length=MAX_SIGNATURE_CHARS)] = ""
    """Signature of `signed`, as `formation.transport.security.signing` makes it."""
    certificate: Annotated[Base64, StringConstraints(max_length=MAX_CERTIFICATE_CHARS)] = ""
    """Of a candidate (X.509, DER). For lack of room it replaces the order, about once a second."""
    term: Count = 0
    """Term of the order that a certificate has replaced; 0 otherwise."""
    readonly: bool = False
    """Whether its agent does not command the robot, and so has no vote."""
    unavailable: bool = False
    """Not tracking, or not closely yet: dependants should prefer another neighbour."""
    searching: bool = False
    """It must see its neighbours and does not yet: its position is no landmark for others."""
    voted_term: Count = 0
    """Voted term; where there are standbys."""
    last_ballot: Count = 0
    """Newest ballot of that term that it has received."""
    mission: Tag = ""
    """Tag of the mission that the sender runs; empty: unknown, which is another one."""
    refused: Count = 0
    """Newest term that it has refused in the last seconds; 0 for none."""
    because: Refusal | None = None
    """Why it refused that term."""
    received: ReceivedPosition | None = None
    """Of one robot that receives it as well, of each in turn: see `formation.agent.following.attachment`."""

    def opened(self) -> Self:
        """Replace the order by the one that was signed."""
        if not self.signed:
            return self
        return self.model_copy(update={"order": _signed_order(self.signed)})


@lru_cache(64)
def _signed_order(text: str) -> Order:
    """Decode a signed order: once, however many neighbours relay it. Raises ValidationError."""
    return Order.model_validate_json(text)


class Ballot(_Json):
    """Asks every follower for its vote in a term, and renews it: see `formation.protocol.election`."""

    term: Count
    number: Count
    """Number of the ballot within its term."""
    candidacy: Literal["candidate", "leader", "leaving"]
    """``leaving``: votes for this term are free at once."""
    mission: Tag = ""
    """As with a position."""


class OperatorRequest(_Json):
    """An operator's request to one robot.

    ``release`` ends a stop, after which the robot holds; ``run`` ends a hold. Both name what they end.
    ``query`` changes nothing: the answer has the ids of the stop and the hold in force. ``drive`` drives the
    leader by hand: `formation.leader.driving`.
    """

    longest: ClassVar[int] = MAX_REQUEST_BYTES
    do: Do
    shape: Name | None = None
    """With ``shape``, and with nothing else: the fleet's new shape."""
    degrees: Annotated[float, Field(ge=-3600.0, le=3600.0, allow_inf_nan=False)] | None = None
    """With ``rotate``: rotation of the shape from its drawing, counter-clockwise. With ``speed``:
    direction, as a mission's ``heading_deg``."""
    factor: Scale | None = None
    """With ``scale``: scale of the shape."""
    speed: Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False)] | None = None
    """With ``speed``: the leader's new speed, from its present position [m/s]."""
    legs: Legs | None = None
    """With ``route``: the leader's new route from its present position."""
    forward: Velocity | None = None
    """With ``drive``: the leader's speed along its heading; negative: backwards [m/s]."""
    turn_rate: Velocity | None = None
    """With ``drive``: counter-clockwise [rad/s]."""
    token: Count | None = None
    """With ``drive``: of the leader's newest reply; 0 before the first."""
    k_p: Proportional | None = None
    """With ``tune``: the law's proportional gain [1/s]; unchanged if missing."""
    k_i: Integral | None = None
    """With ``tune``: the law's integral gain [1/s²], likewise."""
    ends: Annotated[tuple[Name, ...], BeforeValidator(as_tuple), Field(max_length=MAX_ENDED)] = ()
    """With ``release`` and ``run``: ids of the stops or holds that it ends. Any other stays in force."""
    id: Id = ""
    """Id of one request, however often it is sent: a repetition takes no effect a second time. Empty:
    unknown."""
    age: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """Time since it was first sent [s]. A stop or a hold of age 0 is new, whatever its id."""
    mission: Tag = ""
    """Tag of the mission that the operator has named; empty: any. A robot of another one obeys only a stop
    or a hold, see `formation.protocol.addressed`."""

    @property
    def spelled(self) -> dict[str, Any]:
        """Its given fields, for JSON."""
        empty = {name for name in ("ends", "mission") if not getattr(self, name)}
        return self.model_dump(mode="json", exclude_none=True, exclude=empty)

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
        "drive": ("forward", "turn_rate", "token"),
        "tune": ("k_p", "k_i"),
    }
)
"""Fields of each request, all required (with ``tune``, any); requests not listed have none."""
PARTS = tuple(dict.fromkeys(name for takes in TAKES.values() for name in takes))
"""All these fields."""


class OperatorReply(_Json):
    """One robot's answer: whether it obeys, the mode it is now in, and why."""

    robot: Name
    ok: bool
    mode: Mode
    reason: Annotated[str, StringConstraints(max_length=MAX_REASON_CHARS)] = ""
    leads: bool | None = None
    """Whether it leads; None for a robot that cannot."""
    code: Code = ""
    """Code for programs."""
    stop: Id = ""
    """To a ``query``: id of the stop in force; empty for none."""
    hold: Id = ""
    """To a ``query``: id of the hold in force, below a stop too; empty for none."""
    readonly: bool = False
    """Whether it comes from an agent that does not command the robot: another one's answer counts instead."""
    token: Count = 0
    """To a ``drive``: what the next one must return, see `formation.leader.driving`."""


def statement(fingerprint: str, text: str) -> bytes:
    """The bytes that a candidate signs for an order with this text, in the mission with this fingerprint."""
    return f"formation order\n{fingerprint}\n{text}".encode()


J = TypeVar("J", Order, PositionAttachment, Ballot, OperatorRequest, OperatorReply)


def newer(a: Order, b: Order | None) -> bool:
    """Whether `a` supersedes `b`: a later term, or a later beat of the same term. Any supersedes None."""
    return b is None or (a.term, a.beat) > (b.term, b.beat)


def mixed(sender: str, theirs: str, ours: str) -> Reason:
    """Reason that a sender runs another mission; `theirs` and `ours` are tags."""
    if not theirs:
        return Reason.of(ReasonCode.UNKNOWN_MISSION, robot=sender, ours=ours)
    return Reason.of(ReasonCode.OTHER_MISSION, robot=sender, theirs=theirs, ours=ours)


def check_mission(sender: str, theirs: str, ours: str) -> None:
    """Raise BadMessage for a message of another mission than `ours`; both are tags."""
    if theirs != ours:
        raise BadMessage(str(mixed(sender, theirs, ours)))


def encode(value: Order | PositionAttachment | Ballot | OperatorRequest | OperatorReply) -> bytes:
    """Encode as JSON, UTF-8; defaults are omitted, so that older robots understand a stop."""
    given = {"order"} if isinstance(value, PositionAttachment) and value.signed else None
    return value.model_dump_json(exclude_defaults=True, exclude=given).encode()


def shortened(reason: str) -> str:
    """Cut a reason to the space in a reply. The cut is marked, because half a number is a wrong one."""
    shown = reason if len(reason) <= MAX_REASON_CHARS else f"{reason[: MAX_REASON_CHARS - 1]}…"
    while len(to_json(shown)) > MAX_REPLY_REASON_BYTES:  # non-ASCII characters take more than a byte
        shown = f"{shown[:-2]}…"
    return shown


def _read(cls: type[J], data: bytes) -> J:
    return cls.model_validate_json(data).opened()


_read_once = lru_cache(64)(_read)
"""Orders decoded for verification, on the receive thread, are not decoded again in a step."""


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
