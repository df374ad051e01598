from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.rules import too_close
from tests.unit.formation.planar import vectors

discs = st.lists(st.tuples(vectors, st.floats(0.0, 3.0)), max_size=12)


@given(discs)
def test_sweep_equals_comparing_all_pairs(discs: list[tuple[complex, float]]) -> None:
    centres, radii = [centre for centre, _ in discs], [radius for _, radius in discs]
    expected = {
        (i, j)
        for i, j in combinations(range(len(discs)), 2)
        if abs(centres[i] - centres[j]) <= radii[i] + radii[j]
    }
    found = list(too_close(centres, radii))
    assert {(i, j) for i, j, _ in found} == expected
    assert len(found) == len(expected)
    for i, j, distance in found:
        assert distance == pytest.approx(abs(centres[i] - centres[j]))


def test_discs_that_just_touch_are_too_close() -> None:
    assert list(too_close([0j, 2.0 + 0j, 4.5 + 0j], [1.0, 1.0, 1.0])) == [(0, 1, 2.0)]
