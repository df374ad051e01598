"""An operator's request to one robot, and its answer."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, StringConstraints, model_validator
from pydantic_core import PydanticCustomError, to_json

from formation.mission.route import Leg
from formation.mission.tables import as_tuple
from formation.protocol.json_message import MAX_ORDER_BYTES, Count, Id, JsonMessage, Name, Scale, Tag
from formation.protocol.order import Integral, Mode, Proportional

MAX_REQUEST_BYTES = 16_384
"""Greatest size of a request: it may contain a route [bytes]."""

MAX_REASON_CHARS = 400
"""Greatest length of a reason, which may name some robots of up to 64 each [characters]."""
MAX_REPLY_REASON_BYTES = MAX_ORDER_BYTES - 200
"""Space for the reason in a reply [bytes]."""

Do = Literal[
    "hold", "run", "stop", "release", "shape", "rotate", "scale", "speed", "route", "drive", "tune", "query"
]
MAX_ENDED = 200
"""Most stops and holds that one request may end."""
ReplyCode = Literal[
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
    "driven",
]
"""Code of an answer, for programs; empty: only whether it obeys.

``no-link``, ``no-listener``, ``readonly``: a stop or a hold is latched, and cannot reach the robot;
``nothing``: there was nothing to release; ``unnamed``: a release or a run must name what it ends;
``another``: it names another stop or hold than the one in force; ``stopped``: refused while stopped;
``first``: a driver's first request, which only fetches a token; ``other-mission``: it runs another mission
than the request's; ``driven``: a route that joins is refused, as a driver moves the leader by hand.
"""
UNREACHED: frozenset[ReplyCode] = frozenset({"no-link", "no-listener", "readonly"})
"""Codes of an agent that cannot reach its robot."""
Velocity = Annotated[float, Field(allow_inf_nan=False, ge=-1e3, le=1e3)]
Legs = Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1, max_length=500)]


class OperatorRequest(JsonMessage):
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
    joins: bool = False
    """With ``route``: whether the leader joins it where it is, `formation.leader.joining`."""
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
        empty = {name for name in ("ends", "mission", "joins") if not getattr(self, name)}
        return self.model_dump(mode="json", exclude_none=True, exclude=empty)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        takes = TAKES.get(self.do, ())
        given = tuple(name for name in PARTS if getattr(self, name) is not None)
        some = self.do == "tune" and bool(given) and set(given) < set(takes)
        if self.ends and self.do not in {"release", "run"}:
            raise PydanticCustomError("ends", f"{self.do} ends nothing: only release and run do")
        if self.joins and self.do != "route":
            raise PydanticCustomError("joins", f"{self.do} joins nothing: only a route does")
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


class OperatorReply(JsonMessage):
    """One robot's answer: whether it obeys, the mode it is now in, and why."""

    robot: Name
    ok: bool
    mode: Mode
    reason: Annotated[str, StringConstraints(max_length=MAX_REASON_CHARS)] = ""
    leads: bool | None = None
    """Whether it leads; None for a robot that cannot."""
    code: ReplyCode = ""
    """ReplyCode for programs."""
    stop: Id = ""
    """To a ``query``: id of the stop in force; empty for none."""
    hold: Id = ""
    """To a ``query``: id of the hold in force, below a stop too; empty for none."""
    readonly: bool = False
    """Whether it comes from an agent that does not command the robot: another one's answer counts instead."""
    token: Count = 0
    """To a ``drive``: what the next one must return, see `formation.leader.driving`."""


def shortened(reason: str) -> str:
    """Cut a reason to the space in a reply. The cut is marked, because half a number is a wrong one."""
    shown = reason if len(reason) <= MAX_REASON_CHARS else f"{reason[: MAX_REASON_CHARS - 1]}…"
    while len(to_json(shown)) > MAX_REPLY_REASON_BYTES:  # non-ASCII characters take more than a byte
        shown = f"{shown[:-2]}…"
    return shown
