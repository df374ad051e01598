"""Routes that an operator requests, and their messages."""

from __future__ import annotations

import cmath
import json
import math
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from formation.leader.route import NamedRoute
from formation.mission.file import load, parse
from formation.mission.route import Circle, Leg, Straight, Waypoints
from formation.protocol.attachment import (
    MAX_ATTACHMENT_BYTES,
    MAX_SIGNED_BYTES,
    PositionAttachment,
    ReceivedPosition,
)
from formation.protocol.json_message import encode
from formation.protocol.request import MAX_REQUEST_BYTES
from formation.ros2.messages import MAX_PAYLOAD_BYTES as MAX_MESSAGE
from formation.ros2.messages import Text
from formation.ros2.messages import encode as encode_message
from formation.wire import BadMessage
from tests.unit.leader.leading import CURVED, about_to_lead, ask, drive, leading

HEADING = cmath.rect(1.0, 0.7)
numbers = st.floats(-1e4, 1e4)
legs = st.lists(
    st.one_of(
        st.builds(Straight, speed=st.floats(0.0, 2.0), heading_deg=numbers, duration=st.floats(0.1, 100.0)),
        st.builds(
            Circle,
            speed=st.floats(0.1, 2.0),
            radius=st.floats(0.2, 100.0),
            heading_deg=st.none() | numbers,
            turn=st.sampled_from(["left", "right"]),
            duration=st.floats(0.1, 100.0),
        ),
        st.builds(
            Waypoints,
            waypoints=st.lists(st.tuples(numbers, numbers), min_size=1, max_size=4).map(tuple),
            speed=st.floats(0.1, 2.0),
        ),
    ),
    min_size=1,
    max_size=5,
)


@given(legs, numbers, numbers, st.floats(-math.pi, math.pi), st.floats(0.0, 300.0))
def test_decoded_route_equals_the_encoded_one(
    legs: list[Leg], x: float, y: float, heading: float, time: float
) -> None:
    route = NamedRoute.ordered(legs, complex(x, y), cmath.rect(1.0, heading))
    payload = route.payload
    assert payload is not None
    reported = NamedRoute.read(payload)
    assert (reported.id, reported.legs) == (route.id, route.legs)
    assert reported.position(time) == route.position(time)
    assert reported.heading(time) == route.heading(time)


def test_longest_route_request_fits_into_a_message() -> None:
    legs: list[Leg] = [Waypoints(waypoints=((1e5, 1e5),), speed=1.0) for _ in range(500)]
    requested = json.dumps(
        {"do": "route", "legs": [{"waypoints": [[1e5, 1e5]], "speed": 1} for _ in range(300)]}
    )
    assert len(requested) < MAX_REQUEST_BYTES
    payload = NamedRoute.ordered(legs, 1e5 + 1e5j, HEADING).payload
    assert payload is not None
    assert len(payload) < MAX_MESSAGE


@pytest.mark.parametrize(
    "result",
    [
        "",
        "{}",
        "[" * 9000,
        '{"id":"0123456789ab","x":0.0,"y":0.0,"heading":0.0,"legs":[]}',
        '{"id":"0123456789ab","x":0.0,"y":0.0,"heading":0.0,"legs":[{"speed":1.0,"heading_deg":0.0}]}',
        '{"id":"0123456789ab","x":NaN,"y":0.0,"heading":0.0,"legs":[{"speed":1.0,"heading_deg":0.0}]}',
    ],
)
def test_invalid_or_misnamed_route_is_refused(result: str) -> None:
    with pytest.raises(BadMessage):
        NamedRoute.read(encode_message(Text(result)))


def test_speed_request_starts_an_endless_straight() -> None:
    leader = about_to_lead()
    before = drive(leader, 0.0, 5.0)[-1]
    reply = ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}')
    assert reply.ok
    assert reply.reason.startswith("on a route without an end from where it is; stops at the bounds in ")
    result = drive(leader, 5.0, 20.0)
    assert abs(result[0].pose.position - before.pose.position) < 0.02
    way = result[-1].pose.position - result[0].pose.position
    assert way == pytest.approx(0.5j * (result[-1].mono - result[0].mono), abs=1e-3)
    assert result[-1].pose.heading == pytest.approx(1j)
    assert {one.order.route for one in result} == {leader.plan.route.id}
    assert before.order.route == ""


def test_newest_requested_route_is_driven() -> None:
    leader = about_to_lead()
    drive(leader, 0.0, 2.0)
    for x in (7.0, 3.0):
        legs = [{"waypoints": [[x, 0.0]], "speed": 0.8}]
        assert ask(leader, json.dumps({"do": "route", "legs": legs})).ok
    assert drive(leader, 2.0, 20.0)[-1].pose.position == pytest.approx(3.0, abs=1e-6)


def test_zero_speed_stops_leader_while_team_runs() -> None:
    leader = leading()
    assert ask(leader, b'{"do":"speed","speed":0.0,"degrees":0.0}').ok
    result = drive(leader, 0.04, 2.0)
    assert {(one.order.mode, one.pose.position) for one in result[1:]} == {("run", result[1].pose.position)}


def test_impossible_route_is_refused_with_legal_values() -> None:
    leader = leading()
    reply = ask(leader, b'{"do":"speed","speed":1.0,"degrees":0.0}')
    assert (reply.ok, reply.reason) == (False, "speed = 1 m/s: must be below bob's max_speed of 1 m/s")
    reply = ask(leader, b'{"do":"route","legs":[{"radius":0.05,"speed":0.01}]}')
    assert reply.reason == "route.0.radius = 0.05 m: too tight for bob; must be above 0.1 m"
    assert drive(leader, 0.04, 1.0)[-1].order.route == ""


def test_route_request_does_not_end_hold() -> None:
    leader = leading(hold=True)
    assert ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}').mode == "hold"
    assert {one.pose.position for one in drive(leader, 0.04, 2.0)} == {2.0 - 1.0j}
    assert ask(leader, "run").ok
    assert drive(leader, 2.04, 2.0)[-1].pose.position.imag > -0.1


@pytest.mark.parametrize(("length", "mixed"), [(64, 4), (32, 8)])
def test_longest_order_of_worst_mission_can_be_relayed(length: int, mixed: int) -> None:
    names = [f"{k}".rjust(length, "s") for k in range(12)]
    shapes = "".join(f"[shapes.{name}]\nbob = [{-1.1 - k}, {0.1 * k}]\n" for k, name in enumerate(names))
    plain = "[shapes.line]\nbob = [-1.0, 0.0]\n[shapes.near]\nbob = [-0.5, 0.0]\n"
    assert plain in CURVED
    orders = '[law]\nleader_orders = "velocity"\n'
    worst = parse("turning = true" + CURVED.replace(plain, shapes) + orders)
    leader, longest, most = leading(worst), 0, 0
    drive(leader, 0.0, 400.0, 10.0)
    ask(leader, b'{"do":"speed","speed":0.9,"degrees":123.4567}')
    assert ask(leader, b'{"do":"tune","k_p":1.2345678,"k_i":0.0012345678}').ok
    for k, name in enumerate(names[1:]):
        ask(leader, json.dumps({"do": "shape", "shape": name}))
        ask(leader, b'{"do":"scale","factor":1.2345678}')
        ask(leader, b'{"do":"rotate","degrees":-179.99}')
        for result in drive(leader, 500.0 + k, 0.12):
            worded = result.order.model_copy(update={"beat": 2**40, "holding": True, "base_mode": "hold"})
            reported = PositionAttachment(
                publisher_id="v" * 64, count=2**40, order=worded, order_age=0.1234, unavailable=True,
                voted_term=2**63 - 1, last_ballot=2**63 - 1, mission=worst.tag,
                refused=2**63 - 1, because="earlier",
                received=ReceivedPosition(robot="r" * 64, stamp=1_700_000_000.123456),
            )  # fmt: skip
            longest = max(longest, len(encode(reported)))
            most = max(most, len(leader.plan.shape_transition.placed_shape.mix))
            assert len(encode(result.order)) <= MAX_SIGNED_BYTES
    assert most == mixed
    assert 800 < longest < MAX_ATTACHMENT_BYTES - 40


@given(st.floats(0.0, 14.0), st.floats(0.0, 1.0), st.floats(0.1, 1.0))
def test_order_motion_predicts_the_next_second(time: float, age: float, pace: float) -> None:
    route = NamedRoute.of(parse(CURVED))
    motion, later = route.motion(time, pace), time + pace * age
    changes = [one for one in route.begins if time < one <= later]
    assume(len(changes) <= 1 and all(abs(later - one) > 1e-3 for one in changes))
    velocity = 0j if motion is None else motion.after(age)
    way = 0j if motion is None else motion.moved(age)
    assert velocity == pytest.approx(pace * route.velocity(later), abs=1e-5)
    assert way == pytest.approx(route.position(later) - route.position(time), abs=1e-4)


@pytest.mark.parametrize(
    ("leader_orders", "motion"), [("signed", False), ("velocity", True), ("none", False)]
)
def test_order_has_motion_only_if_leader_orders_is_velocity(leader_orders: str, motion: bool) -> None:
    mission = parse(CURVED + f'[law]\nleader_orders = "{leader_orders}"\n')
    order = leading(mission).plan.order(1, 1, "run")
    assert (order.motion is not None) is motion
    assert leading(mission).plan.order(1, 2, "hold").motion is None


@pytest.mark.parametrize("tiny", [5e-324, 1e-310, 1e-300])
@pytest.mark.parametrize(
    "leg",
    [
        {"waypoints": [["tiny", "tiny"]], "speed": 0.1},
        {"waypoints": [[1.0, 0.0], ["tiny", 0.0]], "speed": "tiny"},
        {"radius": 2.0, "speed": "tiny"},
        {"radius": 1e6, "speed": "tiny"},
        {"heading_deg": 10.0, "speed": "tiny"},
    ],
)
def test_tiny_numbers_of_a_route_end_no_leader(leg: dict[str, Any], tiny: float) -> None:
    leader = leading(load("convoy"))
    request = json.dumps({"do": "route", "legs": [leg], "id": "x"}).replace('"tiny"', str(tiny))
    ask(leader, request)
    start = leader.plan.where()
    for one in drive(leader, 0.0, 1.0):
        assert abs(one.pose.heading) == pytest.approx(1.0)
        assert abs(one.pose.position - start) < 0.3
