"""Requests to the team: impossible ones are refused before a robot moves, with the legal values."""

from __future__ import annotations

import math
import re
from itertools import combinations
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from formation.agent.following.gains import Bearable
from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.route import Circle, Leg, Straight
from formation.protocol.json_message import encode
from formation.protocol.order import Tuned
from formation.protocol.request import MAX_REASON_CHARS, MAX_REQUEST_BYTES, PARTS, Do, OperatorRequest
from formation.slots.shape import PlacedShape
from formation.stability import intent, spectrum, tuning
from formation.stability.driving import first_limits
from formation.stability.feasibility import problems
from formation.stability.intent import ordered_shape, refusal, request_for, straight
from tests.campaigns.safety.gains import MARGIN, drawn, held, stable, unstable
from tests.support.examples import slow
from tests.unit.formation import scenarios

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


def test_speed_at_which_robots_turn_too_far_between_commands_is_refused() -> None:
    robot = {"control_point_offset": 0.05, "max_speed": 2.0, "max_turn_rate": 2.0, "rate": 5.0}
    mission = scenarios.build(np.array([0.0, -0.8]), [[], [0]], law={"gain": 2.5}, robot=robot)
    assert refusal(mission, requested(do="speed", speed=0.37, degrees=0.0)) is None
    why = refusal(mission, requested(do="speed", speed=0.38, degrees=0.0))
    assert why is not None
    assert "must be below 0.375 m/s; beyond that robot2 turns too far between two commands, at 5 Hz" in why
    assert first_limits(mission).speed < 0.375
    paper = Mission.model_validate({**mission.model_dump(), "law": {"kind": "paper"}})
    assert refusal(paper, requested(do="speed", speed=0.38, degrees=0.0)) is None


@pytest.mark.parametrize(
    "what",
    [
        {"do": "shape", "shape": "wedge"},
        {"do": "rotate", "degrees": 180.0},
        {"do": "scale", "factor": 0.5},
        {"do": "speed", "speed": 1.0, "degrees": -90.0},
        {"do": "route", "legs": [{"speed": 1.0, "heading_deg": 0.0}]},
        {"do": "stop"},
        {"do": "release"},
    ],
)
def test_possible_request_is_not_refused(what: dict[str, Any]) -> None:
    assert refusal(SIX, requested(**what)) is None
    assert refusal(SIX, requested(**what), FIRST) is None


TOO_FAST = "must be below robot2's max_speed of 1.5 m/s"


def route(*legs: dict[str, Any]) -> dict[str, Any]:
    return {"do": "route", "legs": legs}


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ({"do": "shape", "shape": "circle"}, "shape 'circle': must be one of hexagon, wedge"),
        ({"do": "speed", "speed": 2.0, "degrees": 0.0}, f"speed = 2 m/s: {TOO_FAST}"),
        (route({"waypoints": [[1.0, 1.0]], "speed": 1.5}), f"route.0.speed = 1.5 m/s: {TOO_FAST}"),
        (
            route({"radius": 0.2, "speed": 0.1}),
            "route.0.radius = 0.2 m: too tight for robot2; must be above 0.2 m",
        ),
        (
            route({"radius": 0.5, "speed": 1.2}),
            "route.0.radius = 0.5 m: too tight for robot2; must be above 0.8 m",
        ),
        (
            route({"speed": 0.1, "heading_deg": 0.0}, {"speed": 0.2, "heading_deg": 0.0}),
            "route.0.duration: only the last leg may go without a duration [s]",
        ),
    ],
)
def test_impossible_request_is_refused_with_and_without_placed_shape(what: dict[str, Any], why: str) -> None:
    assert refusal(SIX, requested(**what)) == why
    assert refusal(SIX, requested(**what), FIRST) == why


def test_refusal_of_touching_scale_names_pair_and_smallest_scale() -> None:
    why = refusal(SIX, requested(do="scale", factor=0.1), FIRST)
    assert why == "robot3 and robot4 would touch: 0.1 m apart, must be over 0.2 m; scale must be above 0.201"
    assert refusal(SIX, requested(do="scale", factor=0.201), FIRST) is None
    assert refusal(SIX, requested(do="scale", factor=0.01)) is not None  # in any shape


def test_refusal_names_robots_that_touch_during_transition() -> None:
    why = refusal(MIXED, requested(do="shape", shape="crossed"), FIRST)
    assert why == "robot2 and robot6 would touch on the way: 0 m apart, must be over 0.2 m"
    assert refusal(MIXED, requested(do="shape", shape="crossed")) is None  # the present shape is unknown


@pytest.mark.parametrize("scale", [1.0, 8.0, 100.0])
def test_touching_during_long_shape_transition_is_detected(scale: float) -> None:
    aside = {**CROSSED, "robot2": (CROSSED["robot2"][0], CROSSED["robot2"][1] - 0.3)}
    mission = SIX.model_copy(update={"shapes": {**SIX.shapes, "crossed": aside}})
    why = refusal(mission, requested(do="shape", shape="crossed"), FIRST._replace(scale=scale))
    assert why is not None
    assert why.startswith("robot2 and robot6 would touch on the way")


@pytest.mark.parametrize("rotation", [0.0, 0.3, -2.0])
def test_overlapping_slots_may_be_scaled_apart(rotation: float) -> None:
    small = FIRST._replace(scale=0.15, rotation=rotation)
    assert refusal(SIX, requested(do="scale", factor=1.0), small) is None
    assert refusal(SIX, requested(do="scale", factor=0.16), small) is not None


@given(st.sampled_from(("hexagon", "wedge")), st.floats(0.05, 5.0), st.sampled_from(("hexagon", "wedge")))
def test_request_is_accepted_exactly_if_transition_is_collision_free(
    shape: str, factor: float, before: str
) -> None:
    placed_shape = PlacedShape(((before, 1.0),), 0.3, 1.0)
    request = requested(do="scale", factor=factor) if shape == before else requested(do="shape", shape=shape)
    end = ordered_shape(request, placed_shape)
    assert end is not None
    why = refusal(SIX, request, placed_shape)
    gaps = [gap(SIX, one) for one in straight(placed_shape, end)]
    assert (why is None) == (min(gaps) > 0.0)
    assert why is None or len(why) <= MAX_REASON_CHARS


def test_outermost_slot_of_turning_shape_has_speed_limit() -> None:
    turning = SIX.model_copy(update={"turning": True})
    circle = requested(**route({"radius": 2.0, "speed": 1.0, "turn": "right"}))
    upright = PlacedShape((("hexagon", 1.0),))
    assert refusal(SIX, circle, upright) is None
    assert refusal(turning, circle, upright) == (
        "robot2's slot would swing at 0.5 m/s on the circle of 2 m; must be at most 0.35 m/s"
    )
    legs: tuple[Leg, ...] = (Circle(radius=4.0, speed=0.5), Straight(speed=0.5, heading_deg=0.0))
    assert refusal(turning, requested(do="scale", factor=2.7), upright, legs=legs) is None
    assert refusal(turning, requested(do="scale", factor=2.9), upright, legs=legs) is not None
    assert refusal(SIX, requested(do="scale", factor=2.9), upright, legs=legs) is None


def test_problems_name_shapes_whose_slots_turn_too_fast() -> None:
    upright = SIX.model_copy(update={"route": (Circle(radius=2.0, speed=1.0),)})
    turning = upright.model_copy(update={"turning": True})
    (hexagon, wedge) = (one for one in problems(turning) if "swing" in one)
    assert hexagon.startswith("shapes.hexagon: robot2's slot would swing at ")
    assert wedge.startswith("shapes.wedge: ")
    assert not [one for one in problems(upright) if "swing" in one]


@pytest.mark.parametrize("count", [30, *slow(100)])
def test_every_unstable_gain_is_refused_with_its_eigenvalue(count: int) -> None:
    for mission, gains in unstable(count):
        why = tuning.refusal(mission, gains)
        assert why is not None
        assert "eigenvalue" in why
        assert f"at k_p = {gains.k_p:g}" in why


@pytest.mark.slow
def test_every_stable_gain_is_accepted() -> None:
    drawn_ones = list(stable(100))
    assert sum(tuning.refusal(mission, gains) is None for mission, gains, _ in drawn_ones) == 100
    assert sum(near for _, _, near in drawn_ones) > 20


def settles(mission: Mission, k_p: float, k_i: float) -> bool:
    """Whether the loop settles, sampled at the robots' rate."""
    period = 1.0 / mission.robots[mission.followers[0]].rate
    return held(mission, Tuned(k_p=k_p, k_i=k_i), period) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("side", [1.0 - MARGIN, 1.0 + MARGIN])
def test_gains_are_refused_exactly_where_sampled_loop_diverges(side: float) -> None:
    random, judged = np.random.default_rng(9), 0
    while judged < 100:
        mission = drawn(random, float(random.uniform(2.0, 50.0)), kind="paper")
        k_i = float(10.0 ** random.uniform(-2.0, 0.5))
        fits = [k_p for k_p in np.geomspace(0.01, 100.0, 300).tolist() if settles(mission, k_p, k_i)]
        if not fits:
            continue
        low, high = fits[-1], fits[-1] * 1.1
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if settles(mission, middle, k_i) else (low, middle)
        why = tuning.refusal(mission, Tuned(k_p=low * side, k_i=k_i))
        assert (why is None) == (side < 1.0)
        judged += 1


RING, PAPER = scenarios.ring(12, k_i=0.1, kind="paper"), SIX.under("paper")
TOO_SLOW = "overshoots at robot2's 20 Hz"


@pytest.mark.parametrize(
    ("mission", "typed", "why"),
    [
        (
            RING,
            {"k_i": 30.0},
            r"k_i = 30: unstable, eigenvalue 0\.\d+\+0\.\d+i needs k_i < \d+\.?\d* at k_p = 2",
        ),
        (RING, {"k_p": 0.01}, r"k_p = 0\.01: unstable, eigenvalue \S+ needs k_p > [\d.]+ at k_i = 0\.1"),
        (SIX, {"k_p": 60.0}, rf"k_p = 60: {TOO_SLOW}, eigenvalue 1 needs k_p < 38.9 at k_i = 0"),
        (
            SIX,
            {"k_p": 39.5},
            r"k_p = 39\.5: turns too far at robot2's 20 Hz, period x .* = 2\.02 needs k_p < 38\.9 at k_i = 0",
        ),
        (PAPER, {"k_p": 60.0}, rf"k_p = 60: {TOO_SLOW}, eigenvalue 2 needs k_p < 20 at k_i = .*"),
        (PAPER, {"k_i": 50.0}, rf"k_i = 50: {TOO_SLOW}, eigenvalue \d needs k_i < [\d.]+ at k_p = 2"),
        (PAPER, {"k_p": 1e-3}, r"k_p = 0.001: overshoots .* needs k_p > .*"),
        (PAPER, {"k_p": 900.0, "k_i": 900.0}, r".*no k_p or k_i will do without the other|.*needs .*"),
    ],
)
def test_refusal_names_eigenvalue_and_range(mission: Mission, typed: dict[str, float], why: str) -> None:
    request = requested(do="tune", **typed)
    wanted = intent.tuned(request, Tuned(k_p=mission.gains.k_p, k_i=mission.gains.k_i))
    result = intent.refusal(mission, request, gains=wanted)
    assert result is not None
    assert re.fullmatch(why, result), result
    assert len(result) <= 120
    bound = re.search(r"needs (k_.) ([<>]) ([\d.e+-]+) at", result)
    if bound is not None:
        name, beyond, value = bound[1], bound[2], float(bound[3])
        inside = value * (0.999 if beyond == "<" else 1.001)
        assert tuning.refusal(mission, wanted.model_copy(update={name: inside})) is None
        outside = value * (1.02 if beyond == "<" else 0.98)
        assert tuning.refusal(mission, wanted.model_copy(update={name: outside})) is not None


def test_gains_unstable_by_feed_forward_in_cycle_are_refused() -> None:
    mission = scenarios.ring(6)
    faults = {k_p: tuning.refusal(mission, Tuned(k_p=k_p, k_i=0.0)) for k_p in (1.0, 2.0, 4.0, 6.0, 8.0)}
    assert faults[1.0] is None
    assert faults[8.0] is not None
    for k_p, why in faults.items():
        poles = spectrum.cyclic_poles(mission, k_p, 0.0)
        assert (why is None) == (poles.real.max() < 0.0)


def test_refusal_of_large_cycle_names_pole_without_range() -> None:
    around = np.concatenate([[0.0], 10.0 * np.exp(2j * np.pi * np.arange(40) / 40)])
    mission = scenarios.build(around, ((), (0, 40), *((i,) for i in range(1, 40))))
    why = tuning.refusal(mission, Tuned(k_p=2.0, k_i=0.0))
    assert why is not None
    assert re.fullmatch(
        r"k_p = 2, k_i = 0: unstable with law.feed_forward, pole \S+ 1/s; other gains are needed", why
    )


def test_loop_without_integral_is_judged_by_k_p_alone() -> None:
    assert tuning.refusal(SIX, Tuned(k_p=2.0, k_i=0.0)) is None
    assert tuning.refusal(scenarios.ring(6), Tuned(k_p=2.0, k_i=0.0)) is None
    assert tuning.refusal(PAPER, Tuned(k_p=30.0, k_i=0.0)) is not None
    assert tuning.refusal(SIX, Tuned(k_p=45.0, k_i=50.0)) is not None
    assert tuning.refusal(SIX, Tuned(k_p=30.0, k_i=50.0)) is None


def test_requests_have_unique_ids_and_keep_their_shape() -> None:
    assert len({request_for(SIX, "stop").id for _ in range(10)}) == 10
    assert request_for(SIX, "shape", shape="wedge").shape == "wedge"


@pytest.mark.parametrize(
    ("do", "what", "output"),
    [
        ("fly", {}, "'fly': must be one of hold, run, stop, release, shape"),
        ("hold", {"shape": "wedge"}, "hold: takes no shape"),
        ("rotate", {}, "rotate: rotate takes degrees"),
        ("rotate", {"degrees": 4000.0}, "degrees = 4000.0: must be less than or equal to 3600"),
        ("rotate", {"degrees": "30"}, "degrees = '30': must be a valid number"),
        (
            "route",
            {"legs": [[1, 2]]},
            "legs.0 = .1, 2.: must be a leg: a table of speed and heading_deg, radius",
        ),
        ("route", {"legs": [{"speed": 1.0}]}, "legs.0.straight.heading_deg: must be given"),
        ("scale", {"factor": 0.0}, "factor = 0.0: must be greater than or equal to 0.001"),
        ("speed", {"speed": 0.1}, "speed takes speed and degrees"),
        *(("shape", {"shape": shape}, "must be one of hexagon, wedge") for shape in (None, "circle", "")),
        *(
            ("tune", {"k_p": wrong}, r"tune: k_p = .*: must be")
            for wrong in (0.0, -1.0, 1e-4, 1001.0, math.inf, math.nan)
        ),
    ],
)
def test_request_for_names_illegal_argument_and_legal_values(
    do: str, what: dict[str, Any], output: str
) -> None:
    with pytest.raises(ValueError, match=output):
        request_for(SIX, do, **what)


LEG_KEYS = st.sampled_from(("speed", "heading_deg", "radius", "turn", "waypoints", "duration")) | st.text()
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**400), 10**400) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(LEG_KEYS, inner, max_size=4),
    max_leaves=8,
)


@example("route", {"legs": [[1, 2]]})
@example("route", {"legs": [{"speed": 0.1, "heading_deg": 0.0, 400 * "\n": 1}]})
@example("rotate", {"degrees": 10**400})
@given(st.sampled_from(get_args(Do)) | st.text(), st.dictionaries(st.sampled_from(PARTS), JSON, max_size=3))
def test_any_json_is_obeyed_or_refused_in_one_sentence(do: str, what: dict[str, Any]) -> None:
    try:
        assert request_for(SIX, do, **what).do == do
    except ValueError as error:
        why = str(error)
        assert why.startswith((do, repr(do), *what))
        assert why.isprintable()
        assert len(why) <= MAX_REASON_CHARS


def test_route_above_max_request_bytes_is_refused() -> None:
    legs = [Straight(speed=0.1, heading_deg=100.0 / 3.0, duration=100.0 / 3.0)] * 300
    with pytest.raises(ValueError, match=f"route: too long, at most {MAX_REQUEST_BYTES} bytes are sent"):
        request_for(SIX, "route", legs=legs)
    assert len(encode(request_for(SIX, "route", legs=legs[:100]))) < MAX_REQUEST_BYTES


def test_request_for_does_not_judge_a_single_gain() -> None:
    assert request_for(PAPER, "tune", k_i=50.0).k_i == 50.0  # the leader may have k_p = 10 by now
    with pytest.raises(ValueError, match="k_i = 50: overshoots"):
        request_for(PAPER, "tune", k_i=50.0, k_p=2.0)


@pytest.mark.slow
@settings(max_examples=300)
@given(
    seed=st.integers(0, 2**32), rate=st.floats(1.0, 100.0), k_p=st.floats(-3.0, 3.0), k_i=st.floats(-3.0, 3.0)
)
def test_accepted_gains_are_bearable_for_every_robot(seed: int, rate: float, k_p: float, k_i: float) -> None:
    mission = drawn(np.random.default_rng(seed), rate)
    gains = Tuned(k_p=10.0**k_p, k_i=10.0**k_i)
    assume(tuning.refusal(mission, gains) is None)
    Bearable.of(mission).check(gains)


@given(seed=st.integers(0, 2**32), ends=st.tuples(*[st.floats(-2.0, 2.0)] * 4), part=st.floats(0.0, 1.0))
def test_gains_between_stable_ones_are_stable(
    seed: int, ends: tuple[float, float, float, float], part: float
) -> None:
    mu = spectrum.laplacian(drawn(np.random.default_rng(seed)).graph)
    one, other = np.array(ends[:2]), np.array(ends[2:])
    for gains in (one, other):
        assume(spectrum.stable(mu, *np.exp(gains).tolist()))
    between = np.exp(one + part * (other - one))
    assert spectrum.stable(mu, float(between[0]), float(between[1]) * (1.0 - 1e-9))
