"""Courses that an operator orders, and how others learn of them."""

from __future__ import annotations

import cmath
import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.legs import Circle, Leg, Straight, Waypoints
from formation.mission import Mission
from formation.mission_file import parse
from formation.order import MAX_BYTES, MAX_REQUEST, Told, encode
from formation.ros2.messages import MAX_BYTES as MAX_MESSAGE
from formation.ros2.messages import Text
from formation.ros2.messages import encode as encode_message
from formation.wire import BadMessage
from leader.course import Course
from tests.leader.leading import CURVED, ask, drive, leading, listened

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


@pytest.fixture
def mission() -> Mission:
    return parse(CURVED)


@settings(max_examples=100, deadline=None)
@given(legs, numbers, numbers, st.floats(-math.pi, math.pi), st.floats(0.0, 300.0))
def test_whoever_is_told_a_course_goes_along_the_same_one(
    legs: list[Leg], x: float, y: float, heading: float, time: float
) -> None:
    course = Course.ordered(legs, complex(x, y), cmath.rect(1.0, heading))
    payload = course.payload
    assert payload is not None
    told = Course.read(payload)
    assert (told.id, told.legs) == (course.id, course.legs)
    assert told.position(time) == course.position(time)
    assert told.heading(time) == course.heading(time)


def test_the_longest_route_that_can_be_asked_for_can_be_told() -> None:
    legs: list[Leg] = [Waypoints(waypoints=((1e5, 1e5),), speed=1.0) for _ in range(500)]
    asked = json.dumps({"do": "route", "legs": [{"waypoints": [[1e5, 1e5]], "speed": 1} for _ in range(300)]})
    assert len(asked) < MAX_REQUEST
    payload = Course.ordered(legs, 1e5 + 1e5j, HEADING).payload
    assert payload is not None
    assert len(payload) < MAX_MESSAGE


@pytest.mark.parametrize(
    "said",
    [
        "",
        "{}",
        "[" * 9000,
        '{"id":"0123456789ab","x":0.0,"y":0.0,"heading":0.0,"legs":[]}',
        '{"id":"0123456789ab","x":0.0,"y":0.0,"heading":0.0,"legs":[{"speed":1.0,"heading_deg":0.0}]}',
        '{"id":"0123456789ab","x":NaN,"y":0.0,"heading":0.0,"legs":[{"speed":1.0,"heading_deg":0.0}]}',
    ],
)
def test_what_is_no_course_or_not_the_one_that_it_is_called_is_refused(said: str) -> None:
    with pytest.raises(BadMessage):
        Course.read(encode_message(Text(said)))


def test_a_speed_and_a_heading_are_an_endless_straight_from_where_the_leader_is(mission: Mission) -> None:
    leader = listened(mission)
    before = drive(leader, 0.0, 5.0)[-1]
    reply = ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}')
    assert reply.ok
    assert reply.reason.startswith("on a route without an end from where it is; stops at the bounds in ")
    said = drive(leader, 5.0, 20.0)
    assert abs(said[0].pose.position - before.pose.position) < 0.02
    way = said[-1].pose.position - said[0].pose.position
    assert way == pytest.approx(0.5j * (said[-1].mono - said[0].mono), abs=1e-3)
    assert said[-1].pose.heading == pytest.approx(1j)
    assert {one.order.route for one in said} == {leader.conduct.course.id}
    assert before.order.route == ""


def test_a_route_goes_from_where_the_leader_is_and_the_newest_counts(mission: Mission) -> None:
    leader = listened(mission)
    drive(leader, 0.0, 2.0)
    for x in (7.0, 3.0):
        legs = [{"waypoints": [[x, 0.0]], "speed": 0.8}]
        assert ask(leader, json.dumps({"do": "route", "legs": legs}).encode()).ok
    assert drive(leader, 2.0, 20.0)[-1].pose.position == pytest.approx(3.0, abs=1e-6)


def test_a_speed_of_zero_has_the_leader_stand_while_the_team_runs(mission: Mission) -> None:
    leader = leading(mission)
    assert ask(leader, b'{"do":"speed","speed":0.0,"degrees":0.0}').ok
    said = drive(leader, 0.04, 2.0)
    assert {(one.order.mode, one.pose.position) for one in said[1:]} == {("run", said[1].pose.position)}


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        ('{"do":"speed","speed":1.0,"degrees":0.0}', "speed = 1 m/s: must be below bob's max_speed of 1 m/s"),
        (
            '{"do":"route","legs":[{"radius":0.05,"speed":0.01}]}',
            "route.0.radius = 0.05 m: too tight for bob; must be above 0.1 m",
        ),
        (
            '{"do":"route","legs":[{"radius":0.2,"speed":0.6}]}',
            "route.0.radius = 0.2 m: too tight for bob; must be above 0.4 m",
        ),
        (
            '{"do":"route","legs":[{"speed":0.1,"heading_deg":0.0},{"radius":1.0,"speed":0.1}]}',
            "route.0.duration: only the last leg may go without a duration [s]",
        ),
    ],
)
def test_a_course_that_cannot_be_followed_is_refused_with_what_is_legal(
    mission: Mission, request_: str, why: str
) -> None:
    leader = leading(mission)
    reply = ask(leader, request_.encode())
    assert (reply.ok, reply.reason) == (False, why)
    assert drive(leader, 0.04, 1.0)[-1].order.route == ""


def test_a_course_does_not_set_a_team_going_that_stands(mission: Mission) -> None:
    leader = leading(mission, hold=True)
    assert ask(leader, b'{"do":"speed","speed":0.5,"degrees":90.0}').mode == "hold"
    assert {one.pose.position for one in drive(leader, 0.04, 2.0)} == {2.0 - 1.0j}
    assert ask(leader, b'{"do":"run"}').ok
    assert drive(leader, 2.04, 2.0)[-1].pose.position.imag > -0.1


@pytest.mark.parametrize(("length", "mixed"), [(64, 4), (32, 8)])
def test_the_longest_order_of_the_worst_mission_is_read_by_everybody_who_relays_it(
    length: int, mixed: int
) -> None:
    names = [f"{k}".rjust(length, "s") for k in range(12)]
    shapes = "".join(f"[shapes.{name}]\nbob = [{-1.1 - k}, {0.1 * k}]\n" for k, name in enumerate(names))
    plain = "[shapes.line]\nbob = [-1.0, 0.0]\n[shapes.near]\nbob = [-0.5, 0.0]\n"
    assert plain in CURVED
    worst = parse("turning = true" + CURVED.replace(plain, shapes))
    leader, longest, most = leading(worst), 0, 0
    drive(leader, 0.0, 400.0, 10.0)
    ask(leader, b'{"do":"speed","speed":0.9,"degrees":123.4567}')
    assert ask(leader, b'{"do":"tune","k_p":1.2345678,"k_i":0.0012345678}').ok
    for k, name in enumerate(names[1:]):
        ask(leader, json.dumps({"do": "shape", "shape": name}).encode())
        ask(leader, b'{"do":"scale","factor":1.2345678}')
        ask(leader, b'{"do":"rotate","degrees":-179.99}')
        for said in drive(leader, 500.0 + k, 0.12):
            worded = said.order.model_copy(update={"beat": 2**40, "holding": True, "told": "hold"})
            told = Told(
                voice="v" * 64,
                count=2**40,
                order=worded,
                aside=True,
                promise=2**63 - 1,
                echo=2**63 - 1,
                mission=worst.tag,
                refused=2**63 - 1,
                because="earlier",
            )
            longest, most = max(longest, len(encode(told))), max(most, len(leader.figure.mix))
    assert most == mixed
    assert 800 < longest < MAX_BYTES - 40
