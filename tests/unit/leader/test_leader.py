from __future__ import annotations

import json
import random

import pytest

from formation.leader.core import MAX_BEAT_LEAD
from formation.mission.route import Route
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.reasons import Code
from formation.protocol.request import OperatorReply
from formation.ros2.messages import Diagnostics, Status, decode
from formation.wire import Now
from tests.support.fleet import EPOCH, at
from tests.unit.leader.leading import MISSION, about_to_lead, ask, drive, leading, positions


def test_leader_follows_route_with_irregular_steps() -> None:
    leader, route, chance = about_to_lead(start=500.0), Route.of(MISSION), random.Random(3)
    mono, result = 500.0, []
    while mono < 520.0:
        result += positions(mono, leader.step(at(mono), []))
        mono += chance.choice((0.001, 0.013, 0.04, 0.21))
    assert len(result) > 60
    for mono, pose, *_ in result:
        assert pose.stamp == pytest.approx(at(mono).wall, abs=1e-6)
        assert pose.position == pytest.approx(route.position(mono - 500.0), abs=1e-9)
        assert pose.heading == pytest.approx(route.heading(mono - 500.0), abs=1e-9)


def test_route_pauses_at_leader_timeout_while_leader_is_silent() -> None:
    leader, route = about_to_lead(), Route.of(MISSION)
    drive(leader, 0.0, 2.0)
    (back,) = positions(60.0, leader.step(at(60.0), []))
    lost = leader.route_time
    assert lost == pytest.approx(1.96 + LEADER_TIMEOUT_SECONDS)
    assert back.pose.position == pytest.approx(route.position(lost), abs=1e-9)
    for one in drive(leader, 60.0, 2.0):
        assert one.pose.position == pytest.approx(route.position(lost + one.mono - 60.0), abs=1e-9)


def test_position_and_status_have_their_publication_rates() -> None:
    leader = about_to_lead(start=7.0)
    outbox = [out for i in range(10_000) for out in leader.step(Now(7.0 + i * 1e-3, EPOCH + i * 1e-3), [])]
    keys = [out.key for out in outbox]
    assert (keys.count("ann/position"), keys.count("ann/status")) == (250, 20)
    assert set(keys) == {key for _, key in leader.publications}


def test_beat_rises_with_every_position_in_every_mode() -> None:
    leader, result = about_to_lead(start=100.0), []
    for number, request in enumerate(["run", "hold", "stop", "release"]):
        ask(leader, request)
        result += drive(leader, 100.0 + number, 1.0)
    assert {one.order.mode for one in result} == {"run", "hold", "stop"}
    assert [one.order.beat for one in result] == list(range(1, len(result) + 1))
    assert len({one.order.term for one in result}) == 1
    assert len(result) >= 100


def test_burst_of_orders_does_not_put_beats_ahead() -> None:
    """Robots take later orders for late, and refuse them for a minute."""
    leader, sent = about_to_lead(), []
    for number in range(2000):
        mono = 0.001 * number
        order = {"do": "speed", "speed": 0.1 + 0.0001 * number, "degrees": 0.0, "id": f"speed-{number}"}
        ask(leader, json.dumps(order), mono)
        sent += positions(mono, leader.step(at(mono), []))
    period = leader.rate.period
    assert all((one.order.beat - 1) * period <= one.mono + MAX_BEAT_LEAD + period for one in sent)
    (newest,) = {one.order.route for one in drive(leader, 2.0 + period, period)}
    assert newest == leader.plan.route.id
    ask(leader, "hold", 2.2)
    ask(leader, "run", 2.2)
    ask(leader, json.dumps({"do": "speed", "speed": 0.3, "degrees": 0.0, "id": "last"}), 2.201)
    leader.step(at(2.202), [])
    ask(leader, "stop", 2.203)
    (at_once,) = positions(2.204, leader.step(at(2.204), []))
    assert at_once.order.mode == "stop"


def test_hold_pauses_route_time_until_run() -> None:
    leader, route = about_to_lead(), Route.of(MISSION)
    drive(leader, 0.0, 2.0)
    ask(leader, "hold")
    held = drive(leader, 2.0, 5.0)
    assert {one.order.mode for one in held} == {"hold"}
    assert {one.pose.position for one in held} == {held[0].pose.position}
    assert held[0].pose.position == pytest.approx(route.position(2.0), abs=1e-9)
    ask(leader, "run")
    going = drive(leader, 7.0, 3.0)
    assert going[0].pose.position == held[0].pose.position
    for one in going:
        assert one.pose.position == pytest.approx(route.position(one.mono - 5.0), abs=1e-9)


def test_stop_is_latched_until_release() -> None:
    leader = about_to_lead()
    drive(leader, 0.0, 1.0)
    assert ask(leader, "stop") == OperatorReply(robot="ann", ok=True, mode="stop", leads=True)
    refused = ask(leader, "run")
    assert (refused.ok, refused.mode) == (False, "stop")
    assert "release" in refused.reason
    assert ask(leader, "hold").mode == "stop"
    assert {one.order.mode for one in drive(leader, 1.0, 1.0)} == {"stop"}
    assert leader.route_time == pytest.approx(1.0)
    assert ask(leader, "release").mode == "hold"
    again = ask(leader, "release")
    assert (again.ok, again.code, again.mode) == (True, "nothing", "hold")
    assert ask(leader, "run").mode == "run"


def test_repeated_release_does_not_undo_other_requests() -> None:
    leader = about_to_lead()
    ask(leader, "stop")
    ask(leader, "hold")
    assert [ask(leader, b'{"do":"release","id":"a"}').mode for _ in range(3)] == ["hold"] * 3
    assert {one.order.mode for one in drive(leader, 0.0, 1.0)} == {"hold"}
    ask(leader, b'{"do":"stop","id":"b"}')
    ask(leader, b'{"do":"release","id":"a"}')
    assert {one.order.mode for one in drive(leader, 1.0, 1.0)} == {"stop"}


@pytest.mark.parametrize(("rest", "go", "mode"), [("stop", "release", "hold"), ("hold", "run", "run")])
def test_outdated_release_or_run_is_refused(rest: str, go: str, mode: str) -> None:
    leader = about_to_lead()
    drive(leader, 0.0, 10.0)
    ask(leader, rest, 10.0)
    drive(leader, 10.0, 5.0)
    late = ask(leader, f'{{"do":"{go}","id":"a","age":5.5}}', 15.0)  # given before the stop or hold
    assert (late.ok, late.mode) == (False, rest)
    assert ask(leader, f'{{"do":"{go}","id":"b","age":4.9}}', 15.0).mode == mode


def test_changed_mode_or_shape_is_sent_with_the_next_step() -> None:
    leader = leading()
    assert leader.step(Now(0.001, EPOCH), []) == []
    ask(leader, "stop")
    assert [out.key for out in leader.step(Now(0.002, EPOCH), [])] == ["ann/position", "ann/status"]
    ask(leader, b'{"do":"shape","shape":"near"}')
    (result,) = positions(0.003, leader.step(Now(0.003, EPOCH), []))
    assert result.order.shape == "near"


def test_system_clock_change_moves_stamps_but_not_the_leader() -> None:
    leader, route = about_to_lead(), Route.of(MISSION)
    drive(leader, 0.0, 1.0)
    (result,) = positions(1.0, leader.step(Now(1.0, EPOCH - 86400.0), []))
    assert result.pose.stamp == EPOCH - 86400.0
    assert result.pose.position == pytest.approx(route.position(1.0), abs=1e-9)


def test_last_requested_shape_stays_through_mode_changes() -> None:
    leader, mono = about_to_lead(), 0.0
    assert {one.order.shape for one in drive(leader, mono, 1.0)} == {"line"}
    reply = ask(leader, b'{"do":"shape","shape":"near"}')
    assert (reply.ok, reply.mode, reply.reason) == (True, "run", "in shape near in 3.0 s")
    for do in ("hold", "stop", "release", "release", "run"):
        assert ask(leader, do).ok
        mono += 1.0
        assert {one.order.shape for one in drive(leader, mono, 1.0)} == {"near"}
    ask(leader, b'{"do":"shape","shape":"line"}')
    assert {one.order.shape for one in drive(leader, mono + 1.0, 1.0)} == {"line"}


@pytest.mark.parametrize("mode", ["hold", "stop"])
def test_shape_request_does_not_end_hold_or_stop(mode: str) -> None:
    leader = about_to_lead()
    drive(leader, 0.0, 1.0)
    ask(leader, mode)
    reply = ask(leader, b'{"do":"shape","shape":"near"}')
    assert (reply.ok, reply.mode) == (True, mode)
    assert reply.reason.endswith("s of running")
    assert {one.order.mode for one in drive(leader, 1.0, 0.2)} == {mode}
    placed_shape = leader.plan.shape_transition.placed_shape
    assert {one.order.mode for one in drive(leader, 1.2, 1.0)} == {mode}
    assert leader.plan.shape_transition.placed_shape == placed_shape


def test_unknown_shape_is_refused_with_known_names() -> None:
    leader = leading()
    reply = ask(leader, b'{"do":"shape","shape":"circle"}')
    assert (reply.ok, reply.reason) == (False, "shape 'circle': must be one of line, near")
    assert {one.order.shape for one in drive(leader, 0.0, 1.0)} == {"line"}


def test_refusal_with_too_many_names_is_cut() -> None:
    many = {f"s{number}" + "x" * 60: MISSION.shapes["line"] for number in range(20)}
    reply = ask(leading(MISSION.model_copy(update={"shapes": many})), b'{"do":"shape","shape":"circle"}')
    assert not reply.ok


def test_repeated_shape_request_does_not_undo_later_one() -> None:
    leader = leading()
    ask(leader, b'{"do":"shape","shape":"near","id":"a"}')
    ask(leader, b'{"do":"shape","shape":"line","id":"b"}')
    assert ask(leader, b'{"do":"shape","shape":"near","id":"a"}').ok
    assert leader.plan.shape_transition.ordered.shape == "line"


@pytest.mark.parametrize(
    "request_",
    [
        b"", b"stop", b"{}", b'{"do":"fly"}', b'{"do":"run","now":1}', b'{"do":"shape"}', b"\xff\x00",
        b"[" * 900, b"x" * 5000,
    ],
)  # fmt: skip
def test_malformed_request_is_refused_with_a_reason(request_: bytes) -> None:
    leader = about_to_lead()
    drive(leader, 0.0, 0.2)
    reply = ask(leader, request_)
    assert (reply.robot, reply.ok, reply.mode) == ("ann", False, "run")
    assert reply.reason
    assert leader.dropped == {"order": 1}


def test_status_gives_mode_and_end_of_route() -> None:
    leader = about_to_lead()

    def status(second: int) -> Status:
        (out,) = (out for out in leader.step(at(float(second)), []) if out.key == "ann/status")
        return decode(Diagnostics, out.payload).statuses[0]

    first, *_, last = map(status, range(61))
    assert (first.name, first.hardware_id, first.level, first.message) == ("ann: leader", "ann", 0, "run")
    assert (last.values["state"], last.values["reason"]) == ("run", Code.ROUTE_ENDED)
    assert int(last.values["late"]) > 1000
