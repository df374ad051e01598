"""The geofence: default bounds, orders outside the bounds, and the time when a route leaves them."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.file import MissionError, load, parse, read, shipped
from formation.mission.model import Bounds, Mission
from formation.mission.route import Circle, Route, Straight, Waypoints
from formation.protocol.order import Order, Place, Slots
from formation.slots import geofence
from formation.slots.geofence import BOUNDS_MARGIN_SIZES, MIN_BOUNDS_MARGIN, RETURN_DEPTH, Area, Geofence
from formation.slots.shape import PlacedShape
from formation.wire import BadMessage
from tests.support.examples import examples

SIX = load("six_robots")


def within(mission: Mission, x: tuple[float, float], y: tuple[float, float]) -> Mission:
    return mission.model_copy(update={"bounds": Bounds(x=x, y=y)})


FENCE = Geofence(within(SIX, (-5.0, 25.0), (-4.0, 4.0)))


def ordered(x: float = 0.0, y: float = 0.0, **what: Any) -> Order:
    place = Place(x=x, y=y, heading=0.0)
    return Order.model_validate(
        {"term": 1, "beat": 1, "mode": "run", "shape": "hexagon", "place": place, **what}
    )


@pytest.mark.parametrize("name", shipped())
def test_default_bounds_contain_starts_and_an_hour_of_route(name: str) -> None:
    mission = load(name)
    fence = Geofence(mission)
    first = fence.exit(Route.of(mission), PlacedShape.first(mission)._replace(rotation=0.0))
    assert first is None or first.time > 3600.0
    assert all(fence.holds(robot.start.position) for robot in mission.robots.values())


def test_default_margin_scales_with_formation_and_has_minimum() -> None:
    area = Area.of(SIX)
    assert area.x_min == pytest.approx(-3.5 - 2.0 - BOUNDS_MARGIN_SIZES * 2.0)
    assert area.reach == BOUNDS_MARGIN_SIZES * 2.0
    small = SIX.model_copy(update={"shapes": {"dot": dict.fromkeys(SIX.followers, (-0.1, 0.0))}})
    assert Area.of(small).reach == MIN_BOUNDS_MARGIN


@pytest.mark.parametrize(
    "what",
    [
        {"scale": 14.5},  # puts robot4 29 m from the leader
        {"slots": Slots(mix={"hexagon": 1.0}, scale=1000.0)},
        {"y": -29.0},
        {"place": None, "scale": 1000.0},
    ],
)
def test_default_bounds_refuse_distant_orders(what: dict[str, Any]) -> None:
    with pytest.raises(BadMessage, match=r"order outside the bounds: .* limit"):
        Geofence(SIX).check(ordered(**what))


def test_orders_are_accepted_only_inside_bounds() -> None:
    FENCE.check(ordered(24.9))
    FENCE.check(ordered(scale=2.4))
    with pytest.raises(BadMessage, match=r"the leader at x = 25\.1 m, limit 25 m"):
        FENCE.check(ordered(25.1))
    with pytest.raises(BadMessage, match=r"robot4's slot at x = -6 m, limit -5 m"):
        FENCE.check(ordered(scale=3.0))


def test_robot_counts_as_outside_until_well_inside() -> None:
    assert FENCE.outside(25.0 + 0j, before=False) is None
    assert "x = 31.20 m, limit 25.00 m" in str(FENCE.outside(31.2 + 0j, before=False))
    assert "x = 24.95 m, limit 24.90 m" in str(FENCE.outside(24.95 + 0j, before=True))
    assert FENCE.outside(25.0 - RETURN_DEPTH + 0j, before=True) is None


def test_straight_route_exits_when_first_slot_reaches_bounds() -> None:
    route = Route([Straight(speed=0.5, heading_deg=90.0)], 0j)
    first = FENCE.exit(route, PlacedShape.first(SIX))
    assert first is not None
    assert first.time == pytest.approx((4.0 - FENCE.clearance - 0.866025) / 0.5)
    assert first.words == f"robot2's slot reaches y = {4.0 - FENCE.clearance:.4g} m"


def test_route_back_inside_has_no_exit() -> None:
    back = Route([Waypoints(waypoints=((5.0, 0.0),), speed=0.5)], 30.0 + 0j)
    assert FENCE.exit(back, PlacedShape.first(SIX)) is None
    on = Route([Waypoints(waypoints=((31.0, 0.0),), speed=0.5)], 30.0 + 0j)
    first = FENCE.exit(on, PlacedShape.first(SIX))
    assert first is not None
    assert first.time == 0.0


@pytest.mark.parametrize(("radius", "leaves"), [(1.0, False), (2.5, True)])
def test_exit_considers_the_whole_circle(radius: float, leaves: bool) -> None:
    fence = Geofence(within(SIX, (-10.0, 10.0), (-5.0, 5.0)))
    route = Route([Circle(radius=radius, speed=0.3)], 0j)
    assert (fence.exit(route, PlacedShape.first(SIX)) is not None) is leaves


@given(
    waypoints=st.lists(st.tuples(st.floats(-30, 30), st.floats(-8, 8)), min_size=1, max_size=5),
    turning=st.booleans(),
    since=st.floats(0.0, 20.0),
)
@examples(150)
def test_exit_is_the_first_sample_outside(
    waypoints: list[tuple[float, float]], turning: bool, since: float
) -> None:
    """The oracle samples the route finely and compares each slot with the limits."""
    mission = within(SIX, (-15.0, 25.0), (-6.0, 6.0)).model_copy(update={"turning": turning})
    fence = Geofence(mission)
    route = Route([Waypoints(waypoints=tuple(waypoints), speed=1.0)], 0j)
    placed_shape = PlacedShape((("hexagon", 1.0),))
    first = fence.exit(route, placed_shape, since)
    if fence.area.breach(route.position(since), "", fence.clearance + 2.1).excess >= 0.0:
        return  # a route that begins outside may return, which the oracle does not model
    until = since + 300.0 if first is None else first.time - 1e-3
    for step in range(400):
        time = since + (until - since) * step / 400
        if time > until or time > route.total:
            break
        turned = route.heading(time) if turning else 1.0
        for slot in placed_shape.slots(mission):
            point = route.position(time) + turned * slot
            assert fence.area.breach(point, "", fence.clearance).excess <= 1e-6
    if first is not None and not turning:
        worst = fence.breach([placed_shape], route.position(first.time), fence.clearance)
        assert worst.excess == pytest.approx(0.0, abs=1e-6)


def test_long_path_off_the_bounds_is_not_looked_at_in_detail(monkeypatch: pytest.MonkeyPatch) -> None:
    """The leader sends no position meanwhile."""
    points = tuple((0.01 * number, 0.2 * (number % 2)) for number in range(1, 300))
    inside = Route([Waypoints(waypoints=points, speed=0.5)], 0j)
    outside = Route([Waypoints(waypoints=(*points, (30.0, 0.0)), speed=0.5)], 0j)
    assert FENCE.exit(outside, PlacedShape.first(SIX)) is not None
    monkeypatch.setattr(geofence, "_looks", None)
    assert FENCE.exit(inside, PlacedShape.first(SIX)) is None


TABLE = "[bounds]\nx = [{}, {}]\ny = [{}, {}]\n\n[robots.robot1]"


@pytest.mark.parametrize(
    ("limits", "result"),
    [
        ((-5, 30, -4, 4), ""),
        ((30, -5, -4, 4), "bounds.x = [30.0, -5.0]: must be [least, most] in metres"),
        ((-3, 30, -4, 4), "robots.robot4.start.x = -3.5: must be within the bounds, -3 to 30 m"),
        ((-5, -0.1, -4, 4), "robots.robot1.start.x = 0.0: must be within the bounds"),
        ((-5, "inf", -4, 4), "bounds.x.1 = inf: should be a finite number"),
    ],
)
def test_bounds_in_mission_file_are_read_or_refused(limits: tuple[float, ...], result: str) -> None:
    text = read("six_robots")[0].replace("[robots.robot1]", TABLE.format(*limits))
    if not result:
        assert parse(text).bounds == Bounds(x=(-5.0, 30.0), y=(-4.0, 4.0))
        return
    with pytest.raises(MissionError) as refused:
        parse(text)
    assert result in str(refused.value)


def test_first_shape_outside_bounds_is_refused() -> None:
    text = read("six_robots")[0].replace("[-1.5, 0.866025]", "[-9.0, 0.866025]")
    with pytest.raises(MissionError, match=r"first shape at the start; robot3's slot is at x = -9 m"):
        parse(text.replace("[robots.robot1]", TABLE.format(-5, 30, -4, 4)))


rotations, scales = st.floats(-7, 7), st.floats(0.01, 20.0)
places = st.builds(Place, x=st.floats(-40, 40), y=st.floats(-40, 40), heading=st.floats(-4, 4))
mixes = st.floats(0.0, 1.0).map(lambda share: {"hexagon": share, "wedge": 1.0 - share})
mixed = st.none() | st.builds(Slots, mix=mixes, rotation=rotations, scale=scales)


@given(place=places, rotation=rotations, scale=scales, slots=mixed, turning=st.booleans())
@examples(300)
def test_order_is_accepted_exactly_when_all_slots_are_inside(
    place: Place, rotation: float, scale: float, slots: Slots | None, turning: bool
) -> None:
    """The oracle checks each slot of the present and of the ordered shape."""
    mission = within(SIX, (-12.0, 25.0), (-9.0, 9.0)).model_copy(update={"turning": turning})
    order = ordered(place=place, rotation=rotation, scale=scale, slots=slots)
    wanted = PlacedShape((("hexagon", 1.0),), rotation + (place.heading if turning else 0.0), scale)
    shapes = (PlacedShape.of(order), wanted)
    points = [complex(place.x, place.y) + slot for one in shapes for slot in one.slots(mission)]
    inside = all(-12.0 <= one.real <= 25.0 and -9.0 <= one.imag <= 9.0 for one in points)
    fence = Geofence(mission)
    for _ in range(2):  # the second time with cached shapes
        with nullcontext() if inside else pytest.raises(BadMessage, match="order outside the bounds"):
            fence.check(order)
