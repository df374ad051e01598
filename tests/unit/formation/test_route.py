from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.route import Circle, Route, Straight, Waypoints

NORTH = 1.0j


def test_straight_leg_without_duration_never_ends() -> None:
    route = Route((Straight(speed=0.2, heading_deg=30.0),), 1.0 + 2.0j)
    direction = complex(math.sqrt(0.75), 0.5)
    assert route.total == math.inf
    assert route.position(0.0) == 1.0 + 2.0j
    assert route.position(1000.0) == pytest.approx(1.0 + 2.0j + 200.0 * direction)
    assert route.velocity(1000.0) == pytest.approx(0.2 * direction)
    assert route.heading(1000.0) == pytest.approx(direction)


def test_position_is_continuous_between_legs() -> None:
    legs = (
        Straight(speed=0.5, heading_deg=0.0, duration=4.0),
        Circle(radius=1.0, speed=0.5, duration=math.pi),  # goes on eastwards
        Straight(speed=0.0, heading_deg=0.0, duration=5.0),
        Waypoints(waypoints=((5.0, 5.0), (5.0, 5.0), (0.0, 0.0)), speed=1.0),
        Straight(speed=0.25, heading_deg=-90.0, duration=2.0),
    )
    route, circled = Route(legs, 0j), 4.0 + math.pi
    there = 3.0 + 1.0j
    assert route.position(circled) == route.position(circled + 5.0) == pytest.approx(there)
    assert route.total == pytest.approx(circled + 5.0 + abs(5 + 5j - there) + math.sqrt(50.0) + 2.0)
    times = np.linspace(-1.0, route.total + 1.0, 20_001)
    steps = np.abs(np.diff([route.position(time) for time in times.tolist()])) / np.diff(times)
    assert steps.max() <= 1.0 + 1e-9
    assert route.position(route.total) == pytest.approx(-0.5j)
    assert all(a < b for a, b in pairwise(route.begins))


def test_finished_route_keeps_final_position_and_heading() -> None:
    route = Route((Straight(speed=0.5, heading_deg=90.0, duration=2.0),), 0j)
    assert route.position(2.0) == pytest.approx(1j)
    assert route.position(50.0) == pytest.approx(1j)
    assert route.velocity(1.999) == pytest.approx(0.5j)
    assert route.velocity(2.0) == 0j
    assert route.heading(50.0) == pytest.approx(NORTH)


def test_leader_stands_still_before_route_starts() -> None:
    route = Route((Circle(radius=1.0, speed=0.5),), 3.0 + 0.0j)
    assert route.position(-1.0) == 3.0 + 0.0j
    assert route.velocity(-1.0) == 0j
    assert route.turn_rate(-1.0) == 0.0
    assert route.velocity(0.0) == pytest.approx(0.5 + 0.0j)


@pytest.mark.parametrize(("turn", "side"), [("left", 1.0), ("right", -1.0)])
def test_circle_has_its_centre_on_the_turning_side(turn: Literal["left", "right"], side: float) -> None:
    route = Route((Circle(radius=2.0, speed=0.5, turn=turn),), 0j, start_heading=NORTH)
    assert route.heading(0.0) == NORTH
    assert all(abs(route.position(0.2 * number) + 2.0 * side) == pytest.approx(2.0) for number in range(501))
    assert route.turn_rate(7.0) == pytest.approx(0.25 * side)
    assert route.position(2.0 * math.pi * 2.0 / 0.5) == pytest.approx(0j, abs=1e-12)


def test_waypoints_are_reached_in_order_at_given_speed() -> None:
    route = Route((Waypoints(waypoints=((3.0, 0.0), (3.0, 4.0), (0.0, 0.0)), speed=0.5),), 0j)
    assert route.total == pytest.approx(24.0)
    assert [route.position(t) for t in (6.0, 14.0, 24.0)] == pytest.approx([3 + 0j, 3 + 4j, 0j])
    assert abs(route.velocity(10.0)) == pytest.approx(0.5)


def test_waypoint_at_current_position_takes_no_time() -> None:
    route = Route((Waypoints(waypoints=((0.0, 0.0), (0.0, 0.0)), speed=0.5),), 0j, start_heading=NORTH)
    assert route.total == 0.0
    assert route.position(10.0) == 0j
    assert route.velocity(0.0) == 0j
    assert route.heading(10.0) == NORTH


durations = st.floats(0.1, 20.0)
speeds = st.floats(0.0, 2.0)
angles = st.floats(-360.0, 360.0)
coordinates = st.floats(-9.0, 9.0)
places = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=3).map(tuple)
legs = st.one_of(
    st.builds(Straight, speed=speeds, heading_deg=angles, duration=durations),
    st.builds(
        Circle,
        radius=st.floats(0.1, 10.0),
        speed=st.floats(0.01, 2.0),
        heading_deg=st.none() | angles,
        turn=st.sampled_from(["left", "right"]),
        duration=durations,
    ),
    st.builds(Waypoints, waypoints=places, speed=st.floats(0.1, 2.0)),
)


@given(st.lists(legs, min_size=1, max_size=4))
def test_velocity_is_derivative_of_position(legs: list[Any]) -> None:
    route = Route(legs, 1.0 - 1.0j)
    dt = 1e-6
    for number in range(56):
        time = (number + 0.5) / 56 * (route.total + 1.0)
        slope = (route.position(time + dt) - route.position(time - dt)) / (2.0 * dt)
        velocity, heading = route.velocity(time), route.heading(time)
        assert abs(heading) == pytest.approx(1.0)
        assert abs(velocity) * heading == pytest.approx(velocity, abs=1e-9)
        if all(abs(time - corner) >= 2.0 * dt for corner in route.begins):
            assert slope == pytest.approx(velocity, abs=1e-5)
