"""Paths that a planner sends again and again: the leader joins them where it is."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.leader.core import Leader
from formation.leader.joining import JOINING_TIME, joined
from formation.mission.file import load
from formation.mission.route import Leg, Route, Straight, Waypoints
from formation.protocol import json_message
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.wire import BadMessage
from tests.unit.leader.leading import drive, leading

SPEED = 0.1
CONVOY = load("convoy")
coordinates = st.floats(-50.0, 50.0) | st.sampled_from([0.0, 5e-324, -1e-310, 1e-160])
points = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=12)


def along(path: list[complex]) -> Waypoints:
    return Waypoints(waypoints=tuple((point.real, point.imag) for point in path), speed=SPEED)


def dense(*corners: complex) -> list[complex]:
    return [a + (b - a) * k / 40 for a, b in pairwise(corners) for k in range(40)] + [corners[-1]]


def left(path: list[complex], place: complex, since: float = 0.0) -> list[complex]:
    (leg,) = joined((along(path),), place, 1.0 + 0j, since).legs
    assert isinstance(leg, Waypoints)
    return [complex(x, y) for x, y in leg.waypoints]


def order(leader: Leader, leg: Leg, now: float, name: str, *, joins: bool = True) -> OperatorReply:
    request = OperatorRequest(do="route", legs=(leg,), joins=joins, id=name)
    return json_message.decode(OperatorReply, leader.request(json_message.encode(request), now))


def follow(leader: Leader, path: list[complex], seconds: int) -> list[complex]:
    """Order the same path every second; return the places of the leader."""
    places = []
    for second in range(seconds):
        assert order(leader, along(path), second + 0.01, f"path-{second}").ok
        places += [one.pose.position for one in drive(leader, second + 0.02, 1.0)]
    return places


def test_leader_goes_on_along_repeated_path() -> None:
    places = follow(leading(CONVOY), dense(-0.1 + 0j, 1.0 + 0j), 9)
    assert all(b.real >= a.real for a, b in pairwise(places))
    assert places[-1].real == pytest.approx(9 * SPEED, abs=0.02)


def test_leader_passes_crossing_of_repeated_path_twice() -> None:
    eight = [
        complex(0.5 * math.sin(t), 0.5 * math.sin(t) * math.cos(t)) for t in (0.05 * k for k in range(126))
    ]
    places = follow(leading(CONVOY), eight, 34)
    assert min(place.real for place in places) < -0.4
    assert abs(places[-1] - eight[-1]) < 0.01


def test_leader_turns_back_for_path_without_joining() -> None:
    leader = leading(CONVOY)
    order(leader, along([1.0 + 0j]), 0.01, "first")
    drive(leader, 0.02, 3.0)
    place = leader.plan.where()
    order(leader, along(dense(0j, 1.0 + 0j)), 3.03, "second", joins=False)
    drive(leader, 3.04, 1.0)
    assert leader.plan.where().real < place.real


def test_new_path_is_joined_from_its_beginning_after_another_route() -> None:
    leader, loop = leading(CONVOY), dense(0j, 1.0 + 0j, 1.0 + 1.0j, 0j)
    follow(leader, loop, 40)
    assert abs(leader.plan.where()) < 0.01
    order(leader, Straight(speed=0.0, heading_deg=0.0), 40.1, "other", joins=False)
    order(leader, along(loop), 40.2, "again")
    drive(leader, 40.3, 5.0)
    assert leader.plan.where().real > 0.3


def test_closed_path_is_not_cut_short() -> None:
    assert len(left(dense(0j, 1.0 + 0j, 1.0 + 1.0j, 0j), 0j)) > 100


def test_path_that_begins_elsewhere_is_joined_on_the_path() -> None:
    assert left([2.0 + 0j, 2.0 + 5.0j], 0j) == [2.0 + SPEED * JOINING_TIME * 1j, 2.0 + 5.0j]


def test_leader_stands_at_end_of_path_or_own_place() -> None:
    assert left([0j, 1.0 + 0j], 1.1 + 0j) == [1.0 + 0j]
    assert left([0.5 + 0j], 0.5 + 0j) == [0.5 + 0j]


def test_standing_leader_keeps_its_heading() -> None:
    heading = cmath.rect(1.0, 2.5)
    (leg,) = joined((Straight(speed=0.0, heading_deg=0.0),), 1j, heading).legs
    assert Route((leg,), 1j).heading(1.0) == pytest.approx(heading)
    (leg,) = joined((Straight(speed=0.1, heading_deg=0.0),), 1j, heading).legs
    assert leg == Straight(speed=0.1, heading_deg=0.0)


@given(points, coordinates, coordinates, st.floats(0.0, 100.0))
def test_joined_path_is_rest_of_the_path(
    path: list[tuple[float, float]], x: float, y: float, since: float
) -> None:
    legs = (Waypoints(waypoints=tuple(path), speed=SPEED),)
    result = joined(legs, complex(x, y), 1.0 + 0j, since)
    (leg,) = result.legs
    assert isinstance(leg, Waypoints)
    assert leg.waypoints[-1] == path[-1]
    assert set(leg.waypoints[1:]) <= set(path)
    assert all(math.isfinite(value) for point in leg.waypoints for value in point)
    again = joined(legs, complex(x, y), 1.0 + 0j, result.passed)
    assert again.passed >= result.passed


def test_request_that_joins_must_be_a_route() -> None:
    with pytest.raises(BadMessage, match="hold joins nothing: only a route does"):
        json_message.decode(OperatorRequest, b'{"do":"hold","joins":true}')
