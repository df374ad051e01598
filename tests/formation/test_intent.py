"""What can be asked of a team: refused before anybody moves, in one sentence with what is legal."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.figure import Figure
from formation.intent import refusal, straight, wish
from formation.legs import Circle, Leg, Straight
from formation.mission import Mission
from formation.mission_file import load
from formation.order import LONGEST_REASON, OperatorRequest
from formation.stability.feasibility import problems

SIX = load("six_robots")
FIRST = Figure.first(SIX)
CROSSED = {  # robot2 and robot6 change places, through each other
    **SIX.shapes["hexagon"],
    "robot2": SIX.shapes["hexagon"]["robot6"],
    "robot6": SIX.shapes["hexagon"]["robot2"],
}
MIXED = SIX.model_copy(update={"shapes": {**SIX.shapes, "crossed": CROSSED}})


def asked(**what: object) -> OperatorRequest:
    return OperatorRequest.model_validate(what)


def gap(mission: Mission, figure: Figure) -> float:
    """The least distance of two bodies in formation, negative where they overlap [m]."""
    return min(
        abs(figure.slot(mission, one) - figure.slot(mission, other))
        - mission.robots[one].radius
        - mission.robots[other].radius
        for one, other in combinations(mission.followers, 2)
    )


@pytest.mark.parametrize(
    "request_",
    [
        asked(do="shape", shape="wedge"),
        asked(do="rotate", degrees=180.0),
        asked(do="scale", factor=0.5),
        asked(do="speed", speed=1.0, degrees=-90.0),
        asked(do="route", legs=[{"speed": 1.0, "heading_deg": 0.0}]),
        asked(do="stop"),
        asked(do="release"),
    ],
)
def test_what_can_be_done_is_not_refused(request_: OperatorRequest) -> None:
    assert refusal(SIX, request_) is None
    assert refusal(SIX, request_, FIRST) is None


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (asked(do="shape", shape="circle"), "shape 'circle': must be one of hexagon, wedge"),
        (
            asked(do="speed", speed=2.0, degrees=0.0),
            "speed = 2 m/s: must be below robot2's max_speed of 1.5 m/s",
        ),
        (
            asked(do="route", legs=[{"waypoints": [[1.0, 1.0]], "speed": 1.5}]),
            "route.0.speed = 1.5 m/s: must be below robot2's max_speed of 1.5 m/s",
        ),
    ],
)
def test_what_no_figure_makes_possible_is_refused_by_who_does_not_know_it(
    request_: OperatorRequest, why: str
) -> None:
    assert refusal(SIX, request_) == why
    assert refusal(SIX, request_, FIRST) == why


def test_a_scale_that_makes_slots_touch_names_the_pair_and_the_smallest_legal_one() -> None:
    why = refusal(SIX, asked(do="scale", factor=0.1), FIRST)
    assert why == "robot3 and robot4 would touch: 0.1 m apart, must be over 0.2 m; scale must be above 0.201"
    assert refusal(SIX, asked(do="scale", factor=0.201), FIRST) is None
    assert refusal(SIX, asked(do="scale", factor=0.01)) is not None  # in whatever shape


def test_robots_that_would_touch_on_the_way_only_are_named() -> None:
    why = refusal(MIXED, asked(do="shape", shape="crossed"), FIRST)
    assert why == "robot2 and robot6 would touch on the way: 0 m apart, must be over 0.2 m"
    assert refusal(MIXED, asked(do="shape", shape="crossed")) is None  # nobody knows from where


@pytest.mark.parametrize("scale", [1.0, 8.0, 100.0])
def test_however_long_the_way_robots_do_not_touch_between_two_looks_at_it(scale: float) -> None:
    aside = {**CROSSED, "robot2": (CROSSED["robot2"][0], CROSSED["robot2"][1] - 0.3)}
    mission = SIX.model_copy(update={"shapes": {**SIX.shapes, "crossed": aside}})
    why = refusal(mission, asked(do="shape", shape="crossed"), FIRST._replace(scale=scale))
    assert why is not None
    assert why.startswith("robot2 and robot6 would touch on the way")


@pytest.mark.parametrize("rotation", [0.0, 0.3, -2.0])
def test_slots_that_touch_already_may_come_apart(rotation: float) -> None:
    small = FIRST._replace(scale=0.15, rotation=rotation)
    assert refusal(SIX, asked(do="scale", factor=1.0), small) is None
    assert refusal(SIX, asked(do="scale", factor=0.16), small) is not None


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(("hexagon", "wedge")), st.floats(0.05, 5.0), st.sampled_from(("hexagon", "wedge")))
def test_what_is_granted_touches_nowhere_on_its_straight_way_and_what_is_refused_does(
    shape: str, factor: float, before: str
) -> None:
    figure = Figure(((before, 1.0),), 0.3, 1.0)
    request = asked(do="scale", factor=factor) if shape == before else asked(do="shape", shape=shape)
    end = wish(request, figure)
    assert end is not None
    why = refusal(SIX, request, figure)
    gaps = [gap(SIX, one) for one in straight(figure, end)]
    assert (why is None) == (min(gaps) > 0.0)
    assert why is None or len(why) <= LONGEST_REASON


@pytest.mark.parametrize(
    ("legs", "why"),
    [
        (
            [{"radius": 0.2, "speed": 0.1}],
            "route.0.radius = 0.2 m: too tight for robot2; must be above 0.2 m",
        ),
        (
            [{"radius": 0.5, "speed": 1.2}],
            "route.0.radius = 0.5 m: too tight for robot2; must be above 0.8 m",
        ),
        (
            [{"speed": 0.1, "heading_deg": 0.0}, {"speed": 0.2, "heading_deg": 0.0}],
            "route.0.duration: only the last leg may go without a duration [s]",
        ),
    ],
)
def test_a_route_that_nobody_can_follow_is_refused(legs: list[dict[str, float]], why: str) -> None:
    assert refusal(SIX, asked(do="route", legs=legs)) == why


def test_where_shapes_turn_the_outermost_slot_must_not_swing_too_fast_on_a_circle() -> None:
    turning = SIX.model_copy(update={"turning": True})
    circle = asked(do="route", legs=[{"radius": 2.0, "speed": 1.0, "turn": "right"}])
    upright = Figure((("hexagon", 1.0),))
    assert refusal(SIX, circle, upright) is None
    assert refusal(turning, circle, upright) == (
        "robot2's slot would swing at 0.5 m/s on the circle of 2 m; must be at most 0.35 m/s"
    )
    legs: tuple[Leg, ...] = (Circle(radius=4.0, speed=0.5), Straight(speed=0.5, heading_deg=0.0))
    assert refusal(turning, asked(do="scale", factor=2.7), upright, legs=legs) is None
    assert refusal(turning, asked(do="scale", factor=2.9), upright, legs=legs) is not None
    assert refusal(SIX, asked(do="scale", factor=2.9), upright, legs=legs) is None


def test_check_says_beforehand_which_shapes_cannot_turn_with_the_leader() -> None:
    route = (Circle(radius=2.0, speed=1.0),)
    turning = SIX.model_copy(update={"turning": True, "route": route})
    (hexagon, wedge) = (one for one in problems(turning) if "swing" in one)
    assert hexagon.startswith("shapes.hexagon: robot2's slot would swing at ")
    assert wedge.startswith("shapes.wedge: ")
    assert not [one for one in problems(SIX.model_copy(update={"route": route})) if "swing" in one]
