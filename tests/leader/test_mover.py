"""The figure on its way: within what followers can do, continuous, and in the end where it was wanted."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.figure import Figure
from formation.intent import SHARE
from formation.mission import Mission
from formation.mission_file import load
from leader.mover import LEAST, MOST_SHAPES, SMOOTH, Mover, Wish

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

wishes = st.builds(
    Wish, st.sampled_from(tuple(FOUR.shapes)), st.floats(-math.pi, math.pi), st.floats(0.3, 3.0)
)
speeds = st.floats(0.0, 1.45)
stretches = st.lists(
    st.tuples(st.none() | wishes, speeds, st.floats(-1.0, 1.0), st.integers(1, 60)), max_size=8
)


def slots(mission: Mission, figure: Figure) -> np.ndarray[Any, np.dtype[np.complex128]]:
    return np.array(figure.slots(mission)[1:])


def room(mission: Mission, speed: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    top = np.array([mission.robots[name].max_speed for name in mission.followers])
    return np.maximum(SHARE * (top - speed), LEAST * top)


def want(mover: Mover, wish: Wish, speed: float = 0.0) -> float:
    mover.go(wish, mover.way(wish, speed))
    return mover.remaining


def still(mover: Mover, seconds: float, speed: float = 0.0) -> list[Figure]:
    """Its figures while the leader goes straight on."""
    figures = []
    for _ in range(round(seconds / PERIOD)):
        mover.advance(PERIOD, 1.0, speed, 1.0 + 0j, 0.0)
        figures.append(mover.figure)
    return figures


@settings(max_examples=60, deadline=None)
@given(stretches, st.booleans())
def test_whatever_is_wished_and_however_fast_the_leader_no_slot_is_too_fast_for_its_robot(
    stretches: list[tuple[Wish | None, float, float, int]], turning: bool
) -> None:
    mission = FOUR.model_copy(update={"turning": turning})
    mover, heading = Mover.first(mission), mission.leader_heading
    for wish, speed, turn_rate, steps in stretches:
        if wish is not None and mover.sayable(mover.way(wish, speed)):
            want(mover, wish, speed)
        for _ in range(steps):
            heading *= cmath.rect(1.0, turn_rate * PERIOD)
            before = slots(mission, mover.figure)
            mover.advance(PERIOD, 1.0, speed, heading, turn_rate)
            moved = np.abs(slots(mission, mover.figure) - before) / PERIOD
            assert np.all(moved <= room(mission, speed) + 1e-9)
            assert np.all(speed + moved < np.array([mission.robots[n].max_speed for n in mission.followers]))
            shares = [share for _, share in mover.figure.mix]
            assert sum(shares) == pytest.approx(1.0)
            assert min(shares) >= 0.0


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(wishes, st.integers(1, 60)), min_size=1, max_size=5), st.floats(0.0, 1.0))
def test_it_arrives_exactly_where_it_was_wanted_last_when_it_said_it_would(
    wished: list[tuple[Wish, int]], speed: float
) -> None:
    mover, lasts = Mover.first(FOUR), 0.0
    for wish, steps in wished:
        lasts = want(mover, wish, speed)
        still(mover, steps * PERIOD, speed)
    still(mover, 2.0 * lasts, speed)  # a way that was turned off may need a little longer than was said
    assert mover.arrived
    assert slots(FOUR, mover.figure) == pytest.approx(
        slots(FOUR, Figure(((wish.shape, 1.0),), wish.rotation, wish.scale)), abs=1e-9
    )


def test_it_starts_and_ends_gently() -> None:
    mover = Mover.first(FOUR)
    lasts = want(mover, Wish("line"), 0.2)
    figures = [Figure.first(FOUR), *still(mover, lasts + 0.5, 0.2)]
    velocity = np.diff([slots(FOUR, figure) for figure in figures], axis=0) / PERIOD
    acceleration = np.abs(np.diff(velocity, axis=0)) / PERIOD
    assert np.all(np.abs(velocity[0]) < 0.05)
    assert np.all(np.abs(velocity[-1]) == 0.0)
    assert np.all(acceleration < 1.01 * room(FOUR, 0.2) / SMOOTH)


def test_a_wish_in_the_middle_goes_on_from_where_it_is_without_a_jump_in_velocity() -> None:
    mover = Mover.first(FOUR)
    figures = [Figure.first(FOUR)]
    for wish in (Wish("line"), Wish("wedge", 1.0), Wish("abreast", 0.0, 2.0), Wish("hexagon")):
        lasts = want(mover, wish)
        figures += still(mover, 0.6 * lasts)
    velocity = np.diff([slots(FOUR, figure) for figure in figures], axis=0) / PERIOD
    jumps = np.abs(np.diff(velocity, axis=0))
    assert np.all(jumps < 2.5 * room(FOUR, 0.0) / SMOOTH * PERIOD)


def test_a_leader_nearly_as_fast_as_its_followers_slows_the_change_and_does_not_stop_it() -> None:
    slow, fast = Mover.first(FOUR), Mover.first(FOUR)
    assert want(slow, Wish("line"), 0.2) < 8.0
    lasts = want(fast, Wish("line"), 1.45)
    assert 100.0 < lasts < 200.0
    still(fast, lasts + 1.0, 1.45)
    assert fast.arrived


def test_a_leader_that_speeds_up_meanwhile_slows_the_change() -> None:
    mover = Mover.first(FOUR)
    lasts = want(mover, Wish("line"), 0.2)
    still(mover, 1.5, 0.2)
    still(mover, lasts, 1.4)
    assert not mover.arrived
    still(mover, 3.0 * lasts, 0.2)
    assert mover.arrived


def test_half_turns_go_the_shorter_way_round() -> None:
    mover = Mover.first(FOUR)
    want(mover, Wish("hexagon", math.radians(170.0)))
    still(mover, 60.0)
    want(mover, Wish("hexagon", math.radians(-170.0)))
    turned = [math.degrees(figure.rotation) % 360.0 for figure in still(mover, 60.0)]
    assert all(169.9 < degrees < 190.1 for degrees in turned)
    assert turned[-1] == pytest.approx(190.0)


def test_while_it_rests_nothing_moves_and_it_begins_again_gently() -> None:
    mover = Mover.first(FOUR)
    want(mover, Wish("line"))
    still(mover, 2.0)
    mover.rest()
    before = slots(FOUR, mover.figure)
    (figure,) = still(mover, PERIOD)
    assert np.all(np.abs(slots(FOUR, figure) - before) < 0.05 * PERIOD)


def test_at_most_eight_shapes_are_ever_mixed() -> None:
    many = SIX.model_copy(
        update={
            "shapes": {
                f"shape{k}": {name: (-1.0 * j, 0.3 * k) for j, name in enumerate(SIX.followers, 1)}
                for k in range(12)
            }
        }
    )
    mover, refused = Mover.first(many), 0
    for k in range(1, 12):
        wish = Wish(f"shape{k}")
        way = mover.way(wish, 0.0)
        if not mover.sayable(way):
            refused += 1
            continue
        mover.go(wish, way)
        assert all(len(figure.mix) <= MOST_SHAPES for figure in still(mover, 0.1))
    assert refused
    still(mover, 30.0)
    assert mover.arrived
    assert mover.sayable(mover.way(Wish("shape11"), 0.0))


def test_a_figure_that_turns_follows_the_leader_round_a_corner_and_along_a_circle() -> None:
    mission = FOUR.model_copy(update={"turning": True})
    mover, heading = Mover.first(mission), mission.leader_heading
    heading *= 1j  # a corner
    lags = []
    for _ in range(400):
        mover.advance(PERIOD, 1.0, 0.2, heading, 0.0)
        lags.append(cmath.phase(heading * cmath.rect(1.0, -mover.figure.rotation)))
    assert lags[0] > 1.5
    assert all(after <= before + 1e-9 for before, after in pairwise(lags))
    assert min(lags) > -0.01  # it does not swing over
    assert abs(lags[-1]) < 1e-3
    for _ in range(400):
        heading *= cmath.rect(1.0, 0.1 * PERIOD)
        mover.advance(PERIOD, 1.0, 0.2, heading, 0.1)
    assert cmath.phase(heading * cmath.rect(1.0, -mover.figure.rotation)) == pytest.approx(0.0, abs=1e-3)
    want(mover, Wish("hexagon", math.pi / 2.0), 0.2)
    for _ in range(400):
        mover.advance(PERIOD, 1.0, 0.2, heading, 0.0)
    turned = cmath.phase(heading * cmath.rect(1.0, -mover.figure.rotation))
    assert turned == pytest.approx(-math.pi / 2.0, abs=1e-3)
