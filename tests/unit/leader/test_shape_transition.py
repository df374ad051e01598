"""Shape transitions: within the speed limits of followers, continuous, and exact at the end."""

from __future__ import annotations

import cmath
import math
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.control.arrays import ComplexArray, FloatArray
from formation.leader.shape_transition import (
    MAX_MIXED_SHAPES,
    MIN_SLOT_SPEED_SHARE,
    SMOOTHING_TIME,
    OrderedShape,
    ShapeTransition,
)
from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.route import Waypoints
from formation.simulation.edges import Edges, formation_error
from formation.slots.shape import PlacedShape
from formation.stability.intent import SLOT_SPEED_SHARE
from tests.support.examples import examples
from tests.support.fleet import Fleet
from tests.unit.agent.sudden import largest_command_change
from tests.unit.leader.leading import ask

SIX = load("six_robots")
FOUR = SIX.model_copy(
    update={
        "shapes": {
            **SIX.shapes,
            "line": {name: (-1.0 * k, 0.0) for k, name in enumerate(SIX.followers, 1)},
            "abreast": {name: (0.0, 1.5 * k) for k, name in enumerate(SIX.followers, 1)},
        }
    }
)
PERIOD = 0.05
TOP = np.array([FOUR.robots[name].max_speed for name in FOUR.followers])
"""[m/s]"""

orders = st.builds(
    OrderedShape, st.sampled_from(tuple(FOUR.shapes)), st.floats(-math.pi, math.pi), st.floats(0.3, 3.0)
)
speeds = st.floats(0.0, 1.45)
stretches = st.lists(
    st.tuples(st.none() | orders, speeds, st.floats(-1.0, 1.0), st.integers(1, 60)), max_size=8
)


def slots(mission: Mission, placed_shape: PlacedShape) -> ComplexArray:
    return np.array(placed_shape.slots(mission)[1:])


def room(speed: float) -> FloatArray:
    """Speed that each slot may have behind a leader at this speed [m/s]."""
    return np.maximum(SLOT_SPEED_SHARE * (TOP - speed), MIN_SLOT_SPEED_SHARE * TOP)


def want(moving: ShapeTransition, order: OrderedShape, speed: float = 0.0) -> float:
    moving.follow(order, moving.plan_path(order, speed))
    return moving.remaining


def still(moving: ShapeTransition, seconds: float, speed: float = 0.0) -> list[PlacedShape]:
    placed_shapes = []
    for _ in range(round(seconds / PERIOD)):
        moving.advance(PERIOD, 1.0, speed, 1.0 + 0j, 0.0)
        placed_shapes.append(moving.placed_shape)
    return placed_shapes


def velocities(placed_shapes: list[PlacedShape]) -> ComplexArray:
    """Velocities of all slots between successive placed shapes, from rest in the first shape."""
    places = [slots(FOUR, one) for one in (PlacedShape.first(FOUR), *placed_shapes)]
    return np.diff(places, axis=0) / PERIOD


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(stretches, st.booleans())
def test_slots_never_exceed_speed_of_their_robots(
    stretches: list[tuple[OrderedShape | None, float, float, int]], turning: bool
) -> None:
    mission = FOUR.model_copy(update={"turning": turning})
    moving, heading = ShapeTransition.first(mission), mission.leader_heading
    for order, speed, turn_rate, steps in stretches:
        if order is not None and moving.fits_order(moving.plan_path(order, speed)):
            want(moving, order, speed)
        for _ in range(steps):
            heading *= cmath.rect(1.0, turn_rate * PERIOD)
            before = slots(mission, moving.placed_shape)
            moving.advance(PERIOD, 1.0, speed, heading, turn_rate)
            moved = np.abs(slots(mission, moving.placed_shape) - before) / PERIOD
            assert np.all(moved <= room(speed) + 1e-9)
            assert np.all(speed + moved < TOP)
            shares = [share for _, share in moving.placed_shape.mix]
            assert sum(shares) == pytest.approx(1.0)
            assert min(shares) >= 0.0


@examples(30)
@given(st.lists(st.tuples(orders, st.integers(1, 60)), min_size=1, max_size=5), st.floats(0.0, 1.0))
def test_shape_transition_ends_exactly_at_last_request(
    requests: list[tuple[OrderedShape, int]], speed: float
) -> None:
    moving, lasts = ShapeTransition.first(FOUR), 0.0
    for order, steps in requests:
        lasts = want(moving, order, speed)
        still(moving, steps * PERIOD, speed)
    # an interrupted transition may take a little longer than `remaining`
    still(moving, 2.0 * lasts, speed)
    assert moving.arrived
    assert slots(FOUR, moving.placed_shape) == pytest.approx(
        slots(FOUR, PlacedShape(((order.shape, 1.0),), order.rotation, order.scale)), abs=1e-9
    )


def test_shape_transition_starts_and_ends_slowly() -> None:
    moving = ShapeTransition.first(FOUR)
    velocity = velocities(still(moving, want(moving, OrderedShape("line"), 0.2) + 0.5, 0.2))
    assert np.all(np.abs(velocity[0]) < 0.05)
    assert np.all(np.abs(velocity[-1]) == 0.0)
    assert np.all(np.abs(np.diff(velocity, axis=0)) / PERIOD < 1.01 * room(0.2) / SMOOTHING_TIME)


def test_new_request_during_transition_keeps_velocity_continuous() -> None:
    moving, placed_shapes = ShapeTransition.first(FOUR), []
    for order in (
        OrderedShape("line"),
        OrderedShape("wedge", 1.0),
        OrderedShape("abreast", 0.0, 2.0),
        OrderedShape("hexagon"),
    ):
        placed_shapes += still(moving, 0.6 * want(moving, order))
    jumps = np.abs(np.diff(velocities(placed_shapes), axis=0))
    assert np.all(jumps < 2.5 * room(0.0) / SMOOTHING_TIME * PERIOD)


def test_fast_leader_slows_shape_transition_without_stopping_it() -> None:
    slow, fast = ShapeTransition.first(FOUR), ShapeTransition.first(FOUR)
    assert want(slow, OrderedShape("line"), 0.2) < 8.0
    lasts = want(fast, OrderedShape("line"), 1.45)
    assert 100.0 < lasts < 200.0
    still(fast, lasts + 1.0, 1.45)
    assert fast.arrived


def test_leader_speeding_up_slows_shape_transition() -> None:
    moving = ShapeTransition.first(FOUR)
    lasts = want(moving, OrderedShape("line"), 0.2)
    still(moving, 1.5, 0.2)
    still(moving, lasts, 1.4)
    assert not moving.arrived
    still(moving, 3.0 * lasts, 0.2)
    assert moving.arrived


def test_rotation_takes_the_shorter_way() -> None:
    moving = ShapeTransition.first(FOUR)
    want(moving, OrderedShape("hexagon", math.radians(170.0)))
    still(moving, 60.0)
    want(moving, OrderedShape("hexagon", math.radians(-170.0)))
    turned = [math.degrees(one.rotation) % 360.0 for one in still(moving, 60.0)]
    assert all(169.9 < degrees < 190.1 for degrees in turned)
    assert turned[-1] == pytest.approx(190.0)


def test_shape_transition_restarts_slowly_after_rest() -> None:
    moving = ShapeTransition.first(FOUR)
    want(moving, OrderedShape("line"))
    still(moving, 2.0)
    moving.rest()
    before = slots(FOUR, moving.placed_shape)
    (placed_shape,) = still(moving, PERIOD)
    assert np.all(np.abs(slots(FOUR, placed_shape) - before) < 0.05 * PERIOD)


def test_at_most_eight_shapes_are_mixed() -> None:
    shapes = {
        f"shape{k}": {name: (-1.0 * j, 0.3 * k) for j, name in enumerate(SIX.followers, 1)} for k in range(12)
    }
    moving, refused = ShapeTransition.first(SIX.model_copy(update={"shapes": shapes})), 0
    for k in range(1, 12):
        path = moving.plan_path(OrderedShape(f"shape{k}"), 0.0)
        if not moving.fits_order(path):
            refused += 1
            continue
        moving.follow(OrderedShape(f"shape{k}"), path)
        assert all(len(one.mix) <= MAX_MIXED_SHAPES for one in still(moving, 0.1))
    assert refused
    still(moving, 30.0)
    assert moving.arrived
    assert moving.fits_order(moving.plan_path(OrderedShape("shape11"), 0.0))


def test_turning_shape_follows_leader_through_corner_and_circle() -> None:
    mission = FOUR.model_copy(update={"turning": True})
    moving, heading = ShapeTransition.first(mission), 1j * mission.leader_heading  # a corner

    def follow(turn_rate: float) -> list[float]:
        nonlocal heading
        lags = []
        for _ in range(400):
            heading *= cmath.rect(1.0, turn_rate * PERIOD)
            moving.advance(PERIOD, 1.0, 0.2, heading, turn_rate)
            lags.append(cmath.phase(heading * cmath.rect(1.0, -moving.placed_shape.rotation)))
        return lags

    lags = follow(0.0)
    assert lags[0] > 1.5
    assert all(after <= before + 1e-9 for before, after in pairwise(lags))
    assert min(lags) > -0.01  # it does not overshoot
    assert abs(lags[-1]) < 1e-3
    assert follow(0.1)[-1] == pytest.approx(0.0, abs=1e-3)
    want(moving, OrderedShape("hexagon", math.pi / 2.0), 0.2)
    assert follow(0.0)[-1] == pytest.approx(-math.pi / 2.0, abs=1e-3)


ABREAST = {
    name: (-0.5, y) for name, y in zip(SIX.followers, (1.2, 2.0, 0.0, -2.0, -1.2), strict=True)
}  # fmt: skip
THREE = SIX.model_copy(update={"shapes": {**SIX.shapes, "line": ABREAST}})
TOUCHING = 2.0 * SIX.robot.radius
NEAR = 0.02


class Watched:
    """A fleet with its smallest distance between robots and its largest formation error."""

    def __init__(self, mission: Mission) -> None:
        self.fleet = Fleet(mission, seed=2)
        self.closest, self.worst, self.near = float("inf"), 0.0, 0.0

    def run(self, seconds: float) -> None:
        fleet, mission = self.fleet, self.fleet.mission
        self.closest, self.worst, self.near, began = float("inf"), 0.0, 0.0, fleet.now
        for _ in fleet.every(0.05, seconds):
            bodies = [fleet.world._hosted[name].plant.position for name in mission.followers]
            self.closest = min(self.closest, *(abs(one - other) for one, other in combinations(bodies, 2)))
            self.worst = max(self.worst, self.lag())
            if fleet.error() >= NEAR:
                self.near = fleet.now - began

    def lag(self) -> float:
        """Formation error against the present slots [m]."""
        slots = np.array(self.fleet.leader.plan.shape_transition.placed_shape.slots(self.fleet.mission))
        return float(formation_error(Edges(self.fleet.mission.graph), np.array(self.fleet.points()), slots))

    def want(self, request: str) -> None:
        reply = ask(self.fleet.leader, request.encode())
        assert reply.ok, reply.reason


@pytest.mark.slow
def test_formation_follows_overlapping_shape_requests() -> None:
    watched = Watched(THREE)
    watched.run(15.0)
    since = watched.fleet.now
    for request in (
        '{"do":"scale","factor":1.5}',
        '{"do":"shape","shape":"line"}',
        '{"do":"rotate","degrees":30.0}',
        '{"do":"shape","shape":"hexagon"}',
    ):
        watched.want(request)
        watched.run(0.8)
        assert watched.worst < 0.8
    watched.run(12.0)
    assert watched.near < 9.0
    assert watched.fleet.within_limits
    assert largest_command_change(watched.fleet, since, rests=True) < 0.5


@pytest.mark.slow
def test_turning_formation_follows_leader_around_a_corner() -> None:
    corner = Waypoints(waypoints=((4.0, 0.0), (4.0, 20.0)), speed=0.2)
    watched = Watched(THREE.model_copy(update={"turning": True, "route": (corner,)}))
    watched.run(17.0)
    assert watched.fleet.error() < NEAR
    ahead = watched.fleet.points()
    assert abs(ahead[3] - ahead[0] - (-2.0 + 0.0j)) < NEAR  # robot4 is right behind
    watched.run(18.0)  # the corner comes after 20 s
    assert watched.worst < 0.8
    assert watched.closest > 2.0 * TOUCHING
    ahead = watched.fleet.points()
    assert abs(ahead[3] - ahead[0] - (0.0 - 2.0j)) < NEAR
    assert watched.fleet.within_limits
