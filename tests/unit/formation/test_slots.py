"""Slots: assignment to robots, generated shapes and graphs, and the shipped patrol mission."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.arrays import FloatArray
from formation.mission.file import load
from formation.mission.graph import Graph, cyclic_core
from formation.slots.assignment import AIMS, Aim
from formation.slots.measuring import MAX_HOPS, MAX_NEIGHBOURS, measured
from formation.slots.shapes import SHAPES, polygon
from formation.stability import spectrum
from formation.stability.losses import losing


def squares(numbers: st.SearchStrategy[float], most: int = 6) -> st.SearchStrategy[FloatArray]:
    """Square arrays of costs."""

    def of(n: int) -> st.SearchStrategy[FloatArray]:
        row = st.lists(numbers, min_size=n, max_size=n)
        return st.lists(row, min_size=n, max_size=n).map(lambda rows: np.array(rows, dtype=np.float64))

    return st.integers(1, most).flatmap(of)


TIES = squares(st.integers(0, 3).map(float))
WAYS = squares(st.floats(0.0, 100.0))


@pytest.mark.parametrize("aim", AIMS.values(), ids=AIMS)
@given(costs=TIES | WAYS)
def test_no_other_assignment_is_better(aim: Aim, costs: FloatArray) -> None:
    places = aim.assign(costs)
    assert sorted(places) == list(range(len(costs)))
    least = min(aim.worth(costs, others) for others in permutations(range(len(costs))))
    assert aim.worth(costs, places) == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("aim", AIMS.values(), ids=AIMS)
def test_no_exchange_of_two_robots_improves_assignment(aim: Aim) -> None:
    rng = np.random.default_rng(1)
    robots, slots = rng.normal(size=(2, 100)) + 1j * rng.normal(size=(2, 100))
    costs = np.abs(robots[:, None] - slots)
    places = list(aim.assign(costs))
    found = aim.worth(costs, places)
    for i, k in combinations(range(100), 2):
        other = places.copy()
        other[i], other[k] = other[k], other[i]
        assert found <= tuple(value + 1e-9 for value in aim.worth(costs, other))


def test_aims_total_and_longest_choose_different_assignments() -> None:
    costs = np.array([[0.0, 3.0], [3.0, 5.0]])
    assert AIMS["total"].assign(costs) == (0, 1)
    assert AIMS["longest"].assign(np.array([[0.0, 4.0], [4.0, 5.0]])) == (1, 0)
    assert AIMS["longest"].worth(costs, (1, 0)) == (3.0, 6.0)
    a_nanometre_apart = np.array([[1000.0, 1000.0 + 1e-9], [1000.0, 1000.0]])
    assert AIMS["longest"].assign(a_nanometre_apart) == (0, 1)


PATROL = load("patrol")
MARGIN = 0.15
"""Distance by which two robots may be off their slots, towards each other [m]."""


def nearest(one: str, other: str, mixes: np.ndarray) -> float:
    """Least distance between two slots over mixes of the shapes, one share per column [m]."""
    apart = np.array([PATROL.slot(one, shape) - PATROL.slot(other, shape) for shape in PATROL.shapes])
    return float(np.abs(mixes @ apart).min())


def needed(one: str, other: str) -> float:
    """Distance of two slots at which bodies do not touch, for any headings [m]."""
    first, second = PATROL.robots[one], PATROL.robots[other]
    centres = first.control_point_offset + second.control_point_offset
    return first.radius + second.radius + centres


def test_mixes_of_patrol_shapes_keep_bodies_apart() -> None:
    """Mixes of all three shapes, as one shape transition may replace another."""
    shares = np.linspace(0.0, 1.0, 51)
    mixes = np.array([(a, b, 1.0 - a - b) for a in shares for b in shares if a + b <= 1.0])
    for one, other in combinations(PATROL.followers, 2):
        assert nearest(one, other, mixes) > needed(one, other) + MARGIN


@pytest.mark.parametrize("lost", PATROL.followers)
def test_no_patrol_robot_holds_after_loss_of_another(lost: str) -> None:
    assert losing(PATROL, lost).holding == ()


def test_patrol_slots_move_below_half_of_max_speed() -> None:
    """In the bend the outermost slot is the fastest; half of max_speed is left to correct errors."""
    (bend,) = [leg for leg in PATROL.route if hasattr(leg, "radius")]
    rate = bend.speed / bend.radius
    for shape in PATROL.shapes:
        for name in PATROL.followers:
            speed = abs(bend.speed + 1j * rate * PATROL.slot(name, shape))
            assert speed < 0.5 * PATROL.robots[name].max_speed


NAMES = sorted(SHAPES)
BAR = range(3, 51)


def least_distance(slots: tuple[complex, ...]) -> float:
    return min(abs(a - b) for a, b in combinations(slots, 2))


@pytest.mark.parametrize("name", NAMES)
def test_least_distance_of_generated_slots_is_the_spacing(name: str) -> None:
    for robots in BAR:
        for spacing in (0.4, 1.0, 7.0):
            slots = SHAPES[name](robots, spacing)
            assert len(slots) == robots
            assert least_distance(slots) == pytest.approx(spacing)
        slots = SHAPES[name](robots, 1.0)
        assert min(map(abs, slots)) > 0.5  # none on the leader
        if name not in {"circle", "polygon"}:
            assert max(slot.real for slot in slots) == -1.0  # behind it
        if name in {"line", "column", "grid"}:  # left and right are alike
            assert {round(slot.imag, 9) + 0.0 for slot in slots} == {
                round(-slot.imag, 9) + 0.0 for slot in slots
            }


def test_wedge_has_tip_and_two_arms_at_45_degrees() -> None:
    tip, left, right, *_ = slots = SHAPES["wedge"](7, 1.0)
    assert tip == -1.0
    assert left - tip == pytest.approx(complex(-1, 1) / 2**0.5)
    assert right == pytest.approx(left.conjugate())
    assert slots[5] - tip == pytest.approx(3.0 * (left - tip))


def test_circle_is_centred_on_the_leader() -> None:
    for robots in BAR:
        assert len({round(abs(slot), 9) for slot in SHAPES["circle"](robots, 1.0)}) == 1
    assert polygon(6, 1.0) == pytest.approx(SHAPES["circle"](6, 1.0))


def test_grid_of_16_robots_is_a_square() -> None:
    slots = SHAPES["grid"](16, 0.5)
    assert {round(slot.real, 9) for slot in slots} == {-0.5, -1.0, -1.5, -2.0}
    assert {round(slot.imag, 9) for slot in slots} == {-0.75, -0.25, 0.25, 0.75}


@given(corners=st.integers(3, 12), more=st.integers(0, 30))
def test_polygon_has_robots_on_corners_and_sides(corners: int, more: int) -> None:
    slots = polygon(corners + more, 1.0, corners)
    radius = max(map(abs, slots))
    assert sum(abs(abs(slot) - radius) < 1e-9 for slot in slots) == corners
    assert least_distance(slots) == pytest.approx(1.0)


def check_graph(slots: list[complex]) -> None:
    """Assert what holds for every generated graph."""
    found = measured(slots)
    graph, both = found.graph, Graph(tuple(map(tuple.__add__, *found)))
    assert graph.neighbours[0] == ()
    assert graph.unreachable == ()
    assert max(hops or 0 for hops in graph.depths) <= MAX_HOPS
    assert all(1 <= len(js) <= MAX_NEIGHBOURS for js in graph.neighbours[1:])
    assert all(len(js) == len(set(js)) and i not in js for i, js in enumerate(both.neighbours))
    assert cyclic_core(both) == ()
    assert spectrum.stable(spectrum.laplacian(graph), 0.1, 10.0)
    for i, js in enumerate(both.neighbours[1:], 1):
        assert js == (0,) or len(js) == MAX_NEIGHBOURS, i


@pytest.mark.parametrize("name", NAMES)
def test_generated_graphs_are_rooted_shallow_and_stable(name: str) -> None:
    for robots in BAR:
        check_graph([0j, *SHAPES[name](robots, 1.0)])


POINTS = st.tuples(st.integers(-20, 20), st.integers(-20, 20)).map(lambda xy: complex(*xy))


@given(st.lists(POINTS.filter(bool), min_size=1, max_size=25, unique=True))
def test_no_edge_is_longer_than_needed(slots: list[complex]) -> None:
    points = [0j, *slots]
    check_graph(points)
    graph, count = measured(points).graph, len(points)
    reach = max(abs(points[j] - points[i]) for i, js in enumerate(graph.neighbours) for j in js)
    shorter = [
        tuple(j for j in range(count) if 0.0 < abs(points[j] - points[i]) < reach * 0.999)
        for i in range(1, count)
    ]
    assert any(hops is None or hops > MAX_HOPS for hops in Graph(((), *shorter)).depths)


def test_graph_is_independent_of_size_and_rounding() -> None:
    for name in NAMES:
        small, large = SHAPES[name](23, 0.5), SHAPES[name](23, 8.0)
        rounded = [complex(round(slot.real, 6), round(slot.imag, 6)) for slot in small]
        assert measured([0j, *small]) == measured([0j, *large]) == measured([0j, *rounded])


def test_generated_patrol_graph_equals_the_handmade_one() -> None:
    found = measured(PATROL.slots())
    for i, name in enumerate(PATROL.followers, 1):
        spec = PATROL.robots[name]
        assert tuple(PATROL.names[j] for j in found.neighbours[i]) == spec.neighbours
        assert tuple(PATROL.names[j] for j in found.fallbacks[i]) == spec.fallback_neighbours
