"""Robots that could meet without avoiding each other, as `formation check` warns of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.file import load
from formation.stability.analysis import analyse
from formation.stability.crowding import Segment, between, could_meet, unavoided
from tests.unit.formation import scenarios
from tests.unit.formation.planar import vectors

segments = st.builds(Segment, vectors, vectors)
FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
SIX = load("six_robots")


@given(segments, segments, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_no_two_points_of_two_ways_are_nearer_than_the_ways(
    one: Segment, other: Segment, here: float, there: float
) -> None:
    first = one.begin + here * (one.end - one.begin)
    second = other.begin + there * (other.end - other.begin)
    assert between(one, other) <= abs(first - second) + 1e-9


@pytest.mark.parametrize(
    ("one", "other", "distance"),
    [
        (Segment(-1 + 0j, 1 + 0j), Segment(-1j, 1j), 0.0),
        (Segment(0j, 1 + 0j), Segment(2 + 1j, 2 - 1j), 1.0),
        (Segment(0j, 1 + 0j), Segment(0.5j, 1 + 0.5j), 0.5),
        (Segment(0j, 0j), Segment(3 + 4j, 3 + 4j), 5.0),
    ],
)
def test_the_distance_of_two_ways(one: Segment, other: Segment, distance: float) -> None:
    assert between(one, other) == pytest.approx(distance)


def test_check_warns_of_crossing_ways_without_avoiding() -> None:
    crossing = scenarios.exchanged(FILE, avoid=())
    assert unavoided(crossing) == (("robot2", "robot3"), ("robot2", "robot4"), ("robot3", "robot4"))
    (result,) = could_meet(crossing)
    assert result.startswith("robot2 and robot3 (and 2 other pairs) could meet")
    assert unavoided(scenarios.exchanged(FILE)) == ()
    assert result in analyse(crossing).warnings
    assert result not in analyse(crossing, "paper").warnings


def test_robot_that_stays_at_its_start_meets_none() -> None:
    assert unavoided(scenarios.clearing(FILE, avoid=())) == ()


def test_no_warning_without_collision_avoidance() -> None:
    assert unavoided(scenarios.exchanged(FILE, avoid=(), mode="off")) == ()


def test_printed_law_warns_that_it_avoids_none() -> None:
    result = "the paper law has no collision filter: robots do not avoid each other"
    assert result in analyse(SIX, "paper").warnings
    assert result not in analyse(SIX).warnings
    assert scenarios.six().collisions.mode == "off"
    assert result not in analyse(scenarios.six(), "paper").warnings
