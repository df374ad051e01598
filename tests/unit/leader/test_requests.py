"""Operator requests to a leader: gains, and the requests that its status repeats."""

from __future__ import annotations

import json
from functools import partial
from typing import Any

import numpy as np
import pytest

from formation.leader.core import Leader
from formation.mission.file import load
from formation.mission.model import Bounds, Mission
from formation.mission.route import Straight
from formation.protocol import json_message
from formation.protocol.election import LISTENING_TIME
from formation.protocol.order import Order, Tuned
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.ros2.messages import Diagnostics, decode
from formation.topics import STATUS
from formation.wire import Outgoing
from tests.support.fleet import at, named
from tests.unit.formation import scenarios
from tests.unit.leader.leading import arriving, ask, drive, leading, listens, positions, relayed, status

SIX = load("six_robots")
TUNED = Tuned(k_p=3.0, k_i=0.5)


def tune(leader: Leader, **gains: object) -> tuple[bool, str]:
    reply = ask(leader, json.dumps({"do": "tune", **gains}).encode())
    return reply.ok, reply.reason


def new_leader(mission: Mission, tuned: Tuned | None) -> Leader:
    """A new leader whose robots relay an order with these gains."""
    before = Order(term=1, beat=9, mode="run", shape=mission.first_shape, tuned=tuned)
    leader = Leader(mission)
    leader.step(at(0.0), [])
    near = [name for name in mission.followers if mission.leader in mission.robots[name].neighbours]
    leader.step(at(0.1), [arriving(relayed(name, before, of=mission), 0.1) for name in near])
    leader.step(at(0.1 + LISTENING_TIME), [])
    assert leader.leads
    return leader


def test_gains_are_sent_immediately_and_in_every_order() -> None:
    leader = leading(SIX)
    assert drive(leader, 0.05, 0.5)[-1].order.tuned is None
    ok, reason = tune(leader, k_p=3.0, k_i=0.5)
    assert ok
    assert reason.startswith("k_p = 3, k_i = 0.5; bears a delay of ")
    (at_once,) = positions(0.5511, leader.step(at(0.5511), []))
    assert at_once.order.tuned == TUNED
    assert {one.order.tuned for one in drive(leader, 0.6, 1.0)} == {TUNED}
    result = status(SIX.leader, leader.step(at(2.6), []))
    assert (result.k_p, result.k_i) == (3.0, 0.5)


def test_gains_and_speed_are_judged_together() -> None:
    """Robots at 5 Hz with a control point 5 cm ahead: T (k + v/L) must be below 2."""
    robot = {"control_point_offset": 0.05, "max_speed": 2.0, "max_turn_rate": 2.0, "rate": 5.0}
    route = {"speed": 0.1, "heading_deg": 0.0}
    leader = leading(scenarios.build(np.array([0.0, -0.8]), [[], [0]], route, law={"gain": 2.5}, robot=robot))
    assert ask(leader, b'{"do":"speed","speed":0.3,"degrees":0.0}').ok
    ok, why = tune(leader, k_p=5.0)
    assert not ok
    assert why.startswith("k_p = 5, k_i = ")
    assert "robot2 turns too far between two commands behind a leader at 0.25 m/s or more" in why
    assert ask(leader, b'{"do":"speed","speed":0.1,"degrees":0.0}').ok
    assert tune(leader, k_p=5.0)[0]
    assert not ask(leader, b'{"do":"speed","speed":0.3,"degrees":0.0}').ok


def test_delay_margin_ignores_k_i_under_proportional_law() -> None:
    (_, with_integral), (_, without) = (
        tune(leading(SIX.under(law)), k_p=3.0, k_i=2.9) for law in ("paper", "proportional")
    )
    (_, proportional) = tune(leading(SIX.under("proportional")), k_p=3.0, k_i=0.0)
    assert without.partition("; ")[2] == proportional.partition("; ")[2] != with_integral.partition("; ")[2]


def test_tuning_one_gain_keeps_the_other() -> None:
    leader = leading(SIX)
    assert tune(leader, k_p=3.0)[0]
    assert tune(leader, k_i=0.5)[0]
    assert drive(leader, 0.05, 0.2)[-1].order.tuned == TUNED
    assert tune(leader, k_p=SIX.gains.k_p, k_i=0.0)[0]
    assert drive(leader, 0.3, 0.2)[-1].order.tuned is None  # the mission's gains again


def test_unstable_gain_is_refused_and_not_ordered() -> None:
    leader = leading(scenarios.ring(12, k_i=0.1, kind="paper"))
    ok, reason = tune(leader, k_i=30.0)
    assert not ok
    assert reason.startswith("k_i = 30: unstable, eigenvalue ")
    assert " needs k_i < " in reason
    assert reason.endswith(" at k_p = 2")
    assert drive(leader, 0.05, 0.2)[-1].order.tuned is None


def test_request_with_missing_or_invalid_gain_is_refused() -> None:
    leader = leading(SIX)
    assert tune(leader) == (False, "OperatorRequest: tune takes k_p or k_i")
    assert tune(leader, k_p=3.0, factor=2.0) == (False, "OperatorRequest: tune takes k_p or k_i")
    assert tune(leader, k_p=-1.0)[1].startswith("OperatorRequest: k_p: ")
    assert tune(leader, observer_gain=5.0)[1].startswith("OperatorRequest: observer_gain: ")


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
    """The operator requests in each status."""
    payloads = [one.payload for one in outbox if one.key == STATUS.key("robot1")]
    statuses = [decode(Diagnostics, payload).statuses[0] for payload in payloads]
    return [json.loads(one.values.get("requests", "[]")) for one in statuses]


@pytest.mark.parametrize(
    ("tuned", "adopted"),
    [(TUNED, TUNED), (None, None), (Tuned(k_p=60.0, k_i=1.0), None), (Tuned(k_p=2.0, k_i=50.0), None)],
)
def test_new_leader_orders_the_relayed_gains_if_stable(tuned: Tuned | None, adopted: Tuned | None) -> None:
    assert drive(new_leader(SIX.under("paper"), tuned), 2.0, 0.2)[-1].order.tuned == adopted


def step(leader: Leader, mono: float) -> list[list[dict[str, Any]]]:
    return requested(leader.step(at(mono), []))


def test_status_repeats_each_request_and_reply_for_limited_time() -> None:
    leader, mono = leading(SIX, 10.0), 11.0
    for number, what in enumerate(TEN):
        request = named(OperatorRequest(id=f"{number}", **what), partial(leader.request, received=mono))
        reply = json_message.decode(OperatorReply, leader.request(json_message.encode(request), mono))
        assert reply.ok, reply.reason
        mono += 0.01
        ((*_, newest),) = step(leader, mono)
        assert newest == {**request.spelled, "ok": True, "reason": reply.reason}
    later = [result for k in range(400) for result in step(leader, mono + 0.01 * k)]
    assert later[0]
    assert later[-1] == []


def test_status_contains_a_repeated_refused_request_once() -> None:
    leader = leading(SIX, 10.0)
    small = json_message.encode(OperatorRequest(do="scale", factor=0.01, id="a"))
    for _ in range(3):
        assert not json_message.decode(OperatorReply, leader.request(small, 10.0)).ok
    ((result,),) = step(leader, 11.0)
    assert (result["do"], result["factor"], result["ok"]) == ("scale", 0.01, False)
    assert "would touch" in result["reason"]


def test_refusal_with_long_robot_names_is_complete() -> None:
    text = SIX.model_dump_json()
    for name, long in (("robot3", "a" * 64), ("robot4", "b" * 64)):
        text = text.replace(f'"{name}"', f'"{long}"')
    leader = leading(Mission.model_validate(json.loads(text)), 10.0)
    small = json_message.encode(OperatorRequest(do="scale", factor=0.1, id="a"))
    reason = json_message.decode(OperatorReply, leader.request(small, 10.0)).reason
    assert len(reason) > 200
    assert reason.endswith("; scale must be above 0.201")


def test_repeated_request_reports_current_leadership() -> None:
    leader, stop = Leader(SIX), json_message.encode(OperatorRequest(do="stop", id="a"))
    listens(leader)
    assert json_message.decode(OperatorReply, leader.request(stop, 0.0)).leads is False
    leader.step(at(LISTENING_TIME), [])
    assert json_message.decode(OperatorReply, leader.request(stop, 0.0)).leads is True


@pytest.mark.slow
def test_status_drops_oldest_requests_with_long_routes() -> None:
    anywhere = (-1e5, 1e5)
    leader = leading(SIX.model_copy(update={"bounds": Bounds(x=anywhere, y=anywhere)}))
    legs = [{"waypoints": [[9e4 - k, 9e4]], "speed": 1.0} for k in range(300)]
    for k in range(9):
        request = json.dumps({"do": "route", "legs": legs, "id": str(k)}).encode()
        assert json_message.decode(OperatorReply, leader.request(request, 0.0)).ok
    (result,) = requested(leader.step(at(0.01), []))
    assert 1 <= len(result) < 9
    assert result[-1]["id"] == "8"
