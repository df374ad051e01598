"""Who takes which place: against all permutations."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.arrays import FloatArray
from formation.slots.assignment import AIMS, Aim


def squares(numbers: st.SearchStrategy[float], most: int = 6) -> st.SearchStrategy[FloatArray]:
    """Square arrays of costs."""

    def of(n: int) -> st.SearchStrategy[FloatArray]:
        row = st.lists(numbers, min_size=n, max_size=n)
        return st.lists(row, min_size=n, max_size=n).map(lambda rows: np.array(rows, dtype=np.float64))

    return st.integers(1, most).flatmap(of)


TIES = squares(st.integers(0, 3).map(float))
WAYS = squares(st.floats(0.0, 100.0))


def least(costs: FloatArray, worth: Callable[[FloatArray, tuple[int, ...]], tuple[float, ...]]) -> object:
    return min(worth(costs, places) for places in permutations(range(len(costs))))


@pytest.mark.parametrize("aim", AIMS.values(), ids=AIMS)
@given(costs=TIES | WAYS)
def test_no_other_assignment_is_better(aim: Aim, costs: FloatArray) -> None:
    places = aim.assign(costs)
    assert sorted(places) == list(range(len(costs)))
    assert aim.worth(costs, places) == pytest.approx(least(costs, aim.worth), abs=1e-9)


@pytest.mark.parametrize("aim", AIMS.values(), ids=AIMS)
def test_no_exchange_of_two_robots_improves_assignment(aim: Aim) -> None:
    rng = np.random.default_rng(1)
    robots, slots = rng.normal(size=(2, 100)) + 1j * rng.normal(size=(2, 100))
    costs = np.abs(robots[:, None] - slots)
    places = list(aim.assign(costs))
    found = aim.worth(costs, places)
    for i in range(100):
        for k in range(i):
            other = places.copy()
            other[i], other[k] = other[k], other[i]
            assert found <= tuple(value + 1e-9 for value in aim.worth(costs, other))


def test_the_least_longest_way_can_be_a_longer_one_in_all() -> None:
    costs = np.array([[0.0, 3.0], [3.0, 5.0]])
    assert AIMS["total"].assign(costs) == (0, 1)
    assert AIMS["longest"].assign(np.array([[0.0, 4.0], [4.0, 5.0]])) == (1, 0)
    assert AIMS["longest"].worth(costs, (1, 0)) == (3.0, 6.0)


def test_distances_differing_by_a_nanometre_are_distinguished() -> None:
    costs = np.array([[1000.0, 1000.0 + 1e-9], [1000.0, 1000.0]])
    assert AIMS["longest"].assign(costs) == (0, 1)
