"""Who could meet without minding each other, as `formation check` warns of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission_file import load
from formation.stability.analysis import analyse
from formation.stability.meeting import Way, between, unminded, warnings
from tests.formation import scenarios
from tests.formation.planar import vectors

ways = st.builds(Way, vectors, vectors)
FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
SIX = load("six_robots")


@given(ways, ways, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_no_two_points_of_two_ways_are_nearer_than_the_ways(
    one: Way, other: Way, here: float, there: float
) -> None:
    first = one.begin + here * (one.end - one.begin)
    second = other.begin + there * (other.end - other.begin)
    assert between(one, other) <= abs(first - second) + 1e-9


@pytest.mark.parametrize(
    ("one", "other", "distance"),
    [
        (Way(-1 + 0j, 1 + 0j), Way(-1j, 1j), 0.0),
        (Way(0j, 1 + 0j), Way(2 + 1j, 2 - 1j), 1.0),
        (Way(0j, 1 + 0j), Way(0.5j, 1 + 0.5j), 0.5),
        (Way(0j, 0j), Way(3 + 4j, 3 + 4j), 5.0),
    ],
)
def test_the_distance_of_two_ways(one: Way, other: Way, distance: float) -> None:
    assert between(one, other) == pytest.approx(distance)


def test_whose_ways_cross_is_warned_of_unless_each_minds_the_other() -> None:
    crossing = scenarios.exchanged(FILE, mind=())
    assert unminded(crossing) == (("robot2", "robot3"), ("robot2", "robot4"), ("robot3", "robot4"))
    (said,) = warnings(crossing)
    assert said.startswith("robot2 and robot3 (and 2 other pairs) could meet")
    assert unminded(scenarios.exchanged(FILE)) == ()
    assert said in analyse(crossing).warnings
    assert said not in analyse(crossing, "paper").warnings


def test_who_stays_where_he_starts_meets_nobody() -> None:
    assert unminded(scenarios.clearing(FILE, mind=())) == ()


def test_nobody_is_warned_who_wants_no_collisions_avoided() -> None:
    assert unminded(scenarios.exchanged(FILE, mind=(), mode="off")) == ()


def test_by_the_printed_law_nobody_avoids_anybody_and_that_is_said() -> None:
    said = "by the paper's law commands are as printed, without collision filter: nobody avoids anybody"
    assert said in analyse(SIX, "paper").warnings
    assert said not in analyse(SIX).warnings
    assert scenarios.six().collisions.mode == "off"
    assert said not in analyse(scenarios.six(), "paper").warnings
