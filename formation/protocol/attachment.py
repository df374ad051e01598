"""The attachment of a position, and the ballot of a candidate for the lead.

`PositionAttachment` contains the newest order, and the publisher id, so that a second process of the same
robot, or a recording of the first, is recognised.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, StringConstraints

from formation.protocol.json_message import Count, Id, JsonMessage, Name, Tag
from formation.protocol.order import MAX_MOTION_SECONDS, Order
from formation.protocol.reasons import Code, Reason
from formation.wire import BadMessage

Refusal = Literal["ahead", "earlier"]
"""Why a term is refused: it begins over a day from now, or a later one is in force."""

Base64 = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]*$")]
MAX_SIGNED_BYTES, MAX_SIGNATURE_CHARS, MAX_CERTIFICATE_CHARS = 800, 128, 900
"""Greatest sizes of a signed order [bytes], signature and certificate [characters of Base64]."""


class ReceivedPosition(JsonMessage):
    """The newest position of another robot that a robot has received."""

    robot: Name
    stamp: Annotated[float, Field(allow_inf_nan=False)]
    """Of that position [s, the other robot's clock]."""


MAX_ATTACHMENT_BYTES = 1280
"""Greatest size of a `PositionAttachment` that is read."""


class PositionAttachment(JsonMessage):
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

    @property
    def packed(self) -> set[str] | None:
        """The order, if it is sent as the text that was signed."""
        return {"order"} if self.signed else None

    def opened(self) -> Self:
        """Replace the order by the one that was signed."""
        if not self.signed:
            return self
        return self.model_copy(update={"order": _signed_order(self.signed)})


@lru_cache(64)
def _signed_order(text: str) -> Order:
    """Decode a signed order: once, however many neighbours relay it. Raises ValidationError."""
    return Order.model_validate_json(text)


class Ballot(JsonMessage):
    """Asks every follower for its vote in a term, and renews it: see `formation.protocol.election`."""

    term: Count
    number: Count
    """Number of the ballot within its term."""
    candidacy: Literal["candidate", "leader", "leaving"]
    """``leaving``: votes for this term are free at once."""
    mission: Tag = ""
    """As with a position."""


def mixed(sender: str, theirs: str, ours: str) -> Reason:
    """Reason that a sender runs another mission; `theirs` and `ours` are tags."""
    if not theirs:
        return Reason.of(Code.UNKNOWN_MISSION, robot=sender, ours=ours)
    return Reason.of(Code.OTHER_MISSION, robot=sender, theirs=theirs, ours=ours)


def check_mission(sender: str, theirs: str, ours: str) -> None:
    """Raise BadMessage for a message of another mission than `ours`; both are tags."""
    if theirs != ours:
        raise BadMessage(str(mixed(sender, theirs, ours)))
