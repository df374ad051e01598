"""What can be asked of a team: refused before anybody moves, in one sentence with what is legal."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.route import Circle, Leg, Straight
from formation.protocol.order import MAX_REASON_CHARS, OperatorRequest
from formation.slots.shape import PlacedShape
from formation.stability.feasibility import problems
from formation.stability.intent import refusal, straight, wish

SIX = load("six_robots")
FIRST = PlacedShape.first(SIX)
CROSSED = {  # robot2 and robot6 change places, through each other
    **SIX.shapes["hexagon"],
    "robot2": SIX.shapes["hexagon"]["robot6"],
    "robot6": SIX.shapes["hexagon"]["robot2"],
}
MIXED = SIX.model_copy(update={"shapes": {**SIX.shapes, "crossed": CROSSED}})


def requested(**what: object) -> OperatorRequest:
    return OperatorRequest.model_validate(what)


def gap(mission: Mission, placed_shape: PlacedShape) -> float:
    """The least distance of two bodies in formation, negative where they overlap [m]."""
    return min(
        abs(placed_shape.slot(mission, one) - placed_shape.slot(mission, other))
        - mission.robots[one].radius
        - mission.robots[other].radius
        for one, other in combinations(mission.followers, 2)
    )


@pytest.mark.parametrize(
    "request_",
    [
        requested(do="shape", shape="wedge"),
        requested(do="rotate", degrees=180.0),
        requested(do="scale", factor=0.5),
        requested(do="speed", speed=1.0, degrees=-90.0),
        requested(do="route", legs=[{"speed": 1.0, "heading_deg": 0.0}]),
        requested(do="stop"),
        requested(do="release"),
    ],
)
def test_what_can_be_done_is_not_refused(request_: OperatorRequest) -> None:
    assert refusal(SIX, request_) is None
    assert refusal(SIX, request_, FIRST) is None


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (requested(do="shape", shape="circle"), "shape 'circle': must be one of hexagon, wedge"),
        (
            requested(do="speed", speed=2.0, degrees=0.0),
            "speed = 2 m/s: must be below robot2's max_speed of 1.5 m/s",
        ),
        (
            requested(do="route", legs=[{"waypoints": [[1.0, 1.0]], "speed": 1.5}]),
            "route.0.speed = 1.5 m/s: must be below robot2's max_speed of 1.5 m/s",
        ),
    ],
)
def test_impossible_request_is_refused_without_knowing_current_shape(
    request_: OperatorRequest, why: str
) -> None:
    assert refusal(SIX, request_) == why
    assert refusal(SIX, request_, FIRST) == why


def test_touching_scale_names_pair_and_smallest_legal_scale() -> None:
    why = refusal(SIX, requested(do="scale", factor=0.1), FIRST)
    assert why == "robot3 and robot4 would touch: 0.1 m apart, must be over 0.2 m; scale must be above 0.201"
    assert refusal(SIX, requested(do="scale", factor=0.201), FIRST) is None
    assert refusal(SIX, requested(do="scale", factor=0.01)) is not None  # in whatever shape


def test_robots_that_would_touch_on_the_way_only_are_named() -> None:
    why = refusal(MIXED, requested(do="shape", shape="crossed"), FIRST)
    assert why == "robot2 and robot6 would touch on the way: 0 m apart, must be over 0.2 m"
    assert refusal(MIXED, requested(do="shape", shape="crossed")) is None  # nobody knows from where


@pytest.mark.parametrize("scale", [1.0, 8.0, 100.0])
def test_touching_during_long_shape_transition_is_detected(scale: float) -> None:
    aside = {**CROSSED, "robot2": (CROSSED["robot2"][0], CROSSED["robot2"][1] - 0.3)}
    mission = SIX.model_copy(update={"shapes": {**SIX.shapes, "crossed": aside}})
    why = refusal(mission, requested(do="shape", shape="crossed"), FIRST._replace(scale=scale))
    assert why is not None
    assert why.startswith("robot2 and robot6 would touch on the way")


@pytest.mark.parametrize("rotation", [0.0, 0.3, -2.0])
def test_slots_that_touch_already_may_come_apart(rotation: float) -> None:
    small = FIRST._replace(scale=0.15, rotation=rotation)
    assert refusal(SIX, requested(do="scale", factor=1.0), small) is None
    assert refusal(SIX, requested(do="scale", factor=0.16), small) is not None


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(("hexagon", "wedge")), st.floats(0.05, 5.0), st.sampled_from(("hexagon", "wedge")))
def test_request_is_granted_exactly_if_transition_is_free(shape: str, factor: float, before: str) -> None:
    placed_shape = PlacedShape(((before, 1.0),), 0.3, 1.0)
    request = requested(do="scale", factor=factor) if shape == before else requested(do="shape", shape=shape)
    end = wish(request, placed_shape)
    assert end is not None
    why = refusal(SIX, request, placed_shape)
    gaps = [gap(SIX, one) for one in straight(placed_shape, end)]
    assert (why is None) == (min(gaps) > 0.0)
    assert why is None or len(why) <= MAX_REASON_CHARS


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
def test_impossible_route_is_refused(legs: list[dict[str, float]], why: str) -> None:
    assert refusal(SIX, requested(do="route", legs=legs)) == why


def test_outermost_slot_of_turning_shape_has_speed_limit() -> None:
    turning = SIX.model_copy(update={"turning": True})
    circle = requested(do="route", legs=[{"radius": 2.0, "speed": 1.0, "turn": "right"}])
    upright = PlacedShape((("hexagon", 1.0),))
    assert refusal(SIX, circle, upright) is None
    assert refusal(turning, circle, upright) == (
        "robot2's slot would swing at 0.5 m/s on the circle of 2 m; must be at most 0.35 m/s"
    )
    legs: tuple[Leg, ...] = (Circle(radius=4.0, speed=0.5), Straight(speed=0.5, heading_deg=0.0))
    assert refusal(turning, requested(do="scale", factor=2.7), upright, legs=legs) is None
    assert refusal(turning, requested(do="scale", factor=2.9), upright, legs=legs) is not None
    assert refusal(SIX, requested(do="scale", factor=2.9), upright, legs=legs) is None


def test_check_says_beforehand_which_shapes_cannot_turn_with_the_leader() -> None:
    route = (Circle(radius=2.0, speed=1.0),)
    turning = SIX.model_copy(update={"turning": True, "route": route})
    (hexagon, wedge) = (one for one in problems(turning) if "swing" in one)
    assert hexagon.startswith("shapes.hexagon: robot2's slot would swing at ")
    assert wedge.startswith("shapes.wedge: ")
    assert not [one for one in problems(SIX.model_copy(update={"route": route})) if "swing" in one]
