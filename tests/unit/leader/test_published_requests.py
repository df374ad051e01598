"""What an operator asks of a leader is said in its statuses, so that it is recorded whatever came of it."""

from __future__ import annotations

import json
from functools import partial
from typing import Any

import pytest

from formation.leader.core import Leader
from formation.mission.file import load
from formation.mission.model import Bounds, Mission
from formation.mission.route import Straight
from formation.protocol import order
from formation.protocol.election import LISTENING_TIME
from formation.protocol.order import OperatorReply, OperatorRequest
from formation.ros2.messages import Diagnostics, decode
from formation.topics import STATUS
from formation.wire import Now, Outgoing
from tests.support.named import named
from tests.unit.leader.leading import EPOCH, at, leading

SIX = load("six_robots")
TEN: list[dict[str, Any]] = [
    {"do": "stop"},
    {"do": "release"},
    {"do": "hold"},
    {"do": "run"},
    {"do": "shape", "shape": "wedge"},
    {"do": "rotate", "degrees": -30.0},
    {"do": "scale", "factor": 1.5},
    {"do": "speed", "speed": 0.1, "degrees": 90.0},
    {"do": "route", "legs": (Straight(speed=0.1, heading_deg=0.0),)},
    {"do": "tune", "k_p": 3.0, "k_i": 0.5},
]


def requested(outbox: list[Outgoing]) -> list[list[dict[str, Any]]]:
    """What each status says that an operator asked for."""
    statuses = [
        decode(Diagnostics, one.payload).statuses[0] for one in outbox if one.key == STATUS.key("robot1")
    ]
    return [json.loads(one.values.get("requests", "[]")) for one in statuses]


def step(leader: Leader, mono: float) -> list[list[dict[str, Any]]]:
    return requested(leader.step(Now(mono, EPOCH + mono), []))


def test_each_request_and_reply_are_published_several_times() -> None:
    leader, mono = leading(SIX, 10.0), 11.0
    for number, what in enumerate(TEN):
        request = named(OperatorRequest(id=f"{number}", **what), partial(leader.request, received=mono))
        reply = order.decode(OperatorReply, leader.request(order.encode(request), mono))
        assert reply.ok, reply.reason
        mono += 0.01
        ((*_, newest),) = step(leader, mono)
        reported = {**request.spelled, "ok": True, "reason": reply.reason}
        assert newest == reported
    later = [result for k in range(400) for result in step(leader, mono + 0.01 * k)]
    assert len(later[0]) > 0
    assert later[-1] == []


def test_what_is_refused_is_said_too_and_a_repetition_is_not() -> None:
    leader = leading(SIX, 10.0)
    small = order.encode(OperatorRequest(do="scale", factor=0.01, id="a"))
    for _ in range(3):
        assert not order.decode(OperatorReply, leader.request(small, 10.0)).ok
    ((result,),) = step(leader, 11.0)
    assert (result["do"], result["factor"], result["ok"]) == ("scale", 0.01, False)
    assert "would touch" in result["reason"]


def test_a_refusal_comes_whole_however_long_the_names_are() -> None:
    text = SIX.model_dump_json()
    for name, long in (("robot3", "a" * 64), ("robot4", "b" * 64)):
        text = text.replace(f'"{name}"', f'"{long}"')
    leader = leading(Mission.model_validate(json.loads(text)), 10.0)
    small = order.encode(OperatorRequest(do="scale", factor=0.1, id="a"))
    reason = order.decode(OperatorReply, leader.request(small, 10.0)).reason
    assert len(reason) > 200
    assert reason.endswith("; scale must be above 0.201")


def test_repeated_request_reports_current_leadership() -> None:
    leader, stop = Leader(SIX), order.encode(OperatorRequest(do="stop", id="a"))
    leader.step(at(0.0), [])  # it still listens
    assert order.decode(OperatorReply, leader.request(stop, 0.0)).leads is False
    leader.step(at(LISTENING_TIME), [])
    assert order.decode(OperatorReply, leader.request(stop, 0.0)).leads is True


@pytest.mark.slow
def test_many_long_routes_keep_status_short_enough() -> None:
    anywhere = (-1e5, 1e5)
    leader = leading(SIX.model_copy(update={"bounds": Bounds(x=anywhere, y=anywhere)}))
    legs = [{"waypoints": [[9e4 - k, 9e4]], "speed": 1.0} for k in range(300)]
    for k in range(9):
        request = json.dumps({"do": "route", "legs": legs, "id": str(k)}).encode()
        assert order.decode(OperatorReply, leader.request(request, 0.0)).ok
    (result,) = requested(leader.step(at(0.01), []))
    assert 1 <= len(result) < 9
    assert result[-1]["id"] == "8"
