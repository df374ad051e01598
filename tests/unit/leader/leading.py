"""Leaders driven by tests: messages in, messages out, on a clock that the test sets."""

from __future__ import annotations

import itertools
from contextlib import suppress
from typing import Any, NamedTuple

from formation.leader.core import Leader
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol import json_message, status_codec
from formation.protocol.attachment import PositionAttachment
from formation.protocol.election import LISTENING_TIME
from formation.protocol.order import Order
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import LeaderStatus
from formation.ros2.messages import Pose, decode, encode
from formation.topics import POSITION, STATUS
from formation.wire import BadMessage, Outgoing, Sample
from tests.support.fleet import EPOCH, at, named

_COUNT = itertools.count(1)
CURVED = """
name = "curved"
leader = "ann"
[shapes.line]
bob = [-1.0, 0.0]
[shapes.near]
bob = [-0.5, 0.0]
[robots.ann]
start = { x = 2.0, y = -1.0, heading_deg = 10 }
rate = 25
[robots.bob]
neighbours = ["ann"]
start = { x = 0.0, y = 0.0 }
[[route]]
speed = 0.3
heading_deg = 20
duration = 3.0
[[route]]
radius = 1.5
speed = 0.2
duration = 6.0
[[route]]
waypoints = [[4.0, 4.0], [4.5, 4.0]]
speed = 0.5
"""
MISSION = parse(CURVED)


class SentPosition(NamedTuple):
    """A position of the leader, with its order."""

    mono: float
    pose: Pose
    order: Order
    publisher_id: str = ""


def about_to_lead(mission: Mission = MISSION, start: float = 0.0, **how: Any) -> Leader:
    """A leader that has listened and received no order; it leads from its step at `start`."""
    leader = Leader(mission, **how)
    listens(leader, start - LISTENING_TIME)
    return leader


def listens(leader: Leader, mono: float = 0.0) -> list[Outgoing]:
    """Step a leader that receives a robot without an order, and goes on to wait for other robots' reports.

    For the agent of that robot does not command it.
    """
    of = leader.mission
    near = next(name for name in of.followers if POSITION.key(name) in leader.subscriptions)
    fresh = relayed(near, None, of=of, publisher="readonly", readonly=True)
    return leader.step(at(mono), [arriving(fresh, mono)])


def leading(mission: Mission = MISSION, start: float = 0.0, **how: Any) -> Leader:
    """A leader that leads and has sent its first position."""
    leader = about_to_lead(mission, start, **how)
    leader.step(at(start), [])
    return leader


def positions(mono: float, outbox: list[Outgoing]) -> list[SentPosition]:
    return [
        SentPosition(mono, decode(Pose, out.payload), attachment.order, attachment.publisher_id)
        for out in outbox
        if out.key.endswith("/position")
        and (attachment := json_message.decode(PositionAttachment, out.attachment or b"")).order
    ]


def drive(leader: Leader, start: float, seconds: float, step: float = 0.04) -> list[SentPosition]:
    times = [start + i * step for i in range(round(seconds / step))]
    return [one for mono in times for one in positions(mono, leader.step(at(mono), []))]


def ask(leader: Leader, request: bytes | str, received: float = 0.0) -> OperatorReply:
    """The reply to a request, or to its name; a release or run gets the ids that it ends."""
    if isinstance(request, str):
        request = request.encode() if request[:1] == "{" else f'{{"do":"{request}"}}'.encode()
    with suppress(BadMessage):
        whole = named(
            json_message.decode(OperatorRequest, request), lambda data: leader.request(data, received)
        )
        request = json_message.encode(whole) if whole.ends else request
    return json_message.decode(OperatorReply, leader.request(request, received))


def status(name: str, outbox: list[Outgoing]) -> LeaderStatus:
    (out,) = (out for out in outbox if out.key == STATUS.key(name))
    result = status_codec.read(LeaderStatus, out.payload)
    assert result is not None
    return result


def relayed(
    robot: str,
    what: Order | None,
    count: int | None = None,
    where: complex = 0j,
    *,
    of: Mission = MISSION,
    publisher: str = "of",
    **attachment: Any,
) -> Outgoing:
    """A position of a follower of mission `of`, with the order that it relays."""
    number = next(_COUNT) if count is None else count
    result = PositionAttachment(
        publisher_id=f"{publisher}-{robot}", count=number, order=what, mission=of.tag, **attachment
    )
    return Outgoing(POSITION.key(robot), encode(Pose(EPOCH, where, 1.0 + 0j)), json_message.encode(result))


def arriving(out: Outgoing, mono: float) -> Sample:
    return Sample(out.key, out.payload, out.attachment, mono)
