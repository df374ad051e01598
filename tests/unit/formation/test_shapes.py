"""Shapes by generator, and the graph that goes with them."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.graph import Graph, cyclic_core
from formation.slots.measuring import MAX_HOPS, MAX_NEIGHBOURS, measured
from formation.slots.shapes import SHAPES, polygon
from formation.stability import spectrum

NAMES = sorted(SHAPES)
BAR = range(3, 51)


def nearest(slots: tuple[complex, ...]) -> float:
    return min(abs(a - b) for a, b in combinations(slots, 2))


def with_leader(slots: tuple[complex, ...]) -> list[complex]:
    return [0j, *slots]


@pytest.mark.parametrize("name", NAMES)
def test_neighbouring_slots_are_a_spacing_apart_and_no_two_are_nearer(name: str) -> None:
    for robots in BAR:
        for spacing in (0.4, 1.0, 7.0):
            slots = SHAPES[name](robots, spacing)
            assert len(slots) == robots
            assert nearest(slots) == pytest.approx(spacing)


@pytest.mark.parametrize("name", NAMES)
def test_no_slot_is_on_the_leader(name: str) -> None:
    assert all(min(map(abs, SHAPES[name](robots, 1.0))) > 0.5 for robots in BAR)


@pytest.mark.parametrize("name", ["line", "column", "wedge", "grid"])
def test_followers_are_behind_the_leader(name: str) -> None:
    assert all(max(slot.real for slot in SHAPES[name](robots, 1.0)) == -1.0 for robots in BAR)


@pytest.mark.parametrize("name", ["line", "column", "grid"])
def test_left_and_right_are_alike(name: str) -> None:
    for robots in BAR:
        slots = SHAPES[name](robots, 1.0)
        assert {round(slot.imag, 9) + 0.0 for slot in slots} == {round(-slot.imag, 9) + 0.0 for slot in slots}


def test_a_wedge_is_a_tip_and_two_arms_of_45_degrees() -> None:
    tip, left, right, *_ = slots = SHAPES["wedge"](7, 1.0)
    assert tip == -1.0
    assert left - tip == pytest.approx(complex(-1, 1) / 2**0.5)
    assert right == pytest.approx(left.conjugate())
    assert slots[5] - tip == pytest.approx(3.0 * (left - tip))


def test_a_circle_is_round_the_leader() -> None:
    for robots in BAR:
        assert len({round(abs(slot), 9) for slot in SHAPES["circle"](robots, 1.0)}) == 1


def test_a_grid_of_a_square_number_is_a_square() -> None:
    slots = SHAPES["grid"](16, 0.5)
    assert {round(slot.real, 9) for slot in slots} == {-0.5, -1.0, -1.5, -2.0}
    assert {round(slot.imag, 9) for slot in slots} == {-0.75, -0.25, 0.25, 0.75}


def test_the_paper_s_hexagon_is_a_polygon_of_six() -> None:
    assert polygon(6, 1.0) == pytest.approx(SHAPES["circle"](6, 1.0))


@given(corners=st.integers(3, 12), more=st.integers(0, 30))
def test_polygon_has_robots_on_corners_and_sides(corners: int, more: int) -> None:
    slots = polygon(corners + more, 1.0, corners)
    radius = max(map(abs, slots))
    assert sum(abs(abs(slot) - radius) < 1e-9 for slot in slots) == corners
    assert nearest(slots) == pytest.approx(1.0)


def check_graph(slots: list[complex]) -> None:
    """What holds of every graph that is chosen."""
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
        check_graph(with_leader(SHAPES[name](robots, 1.0)))


POINTS = st.tuples(st.integers(-20, 20), st.integers(-20, 20)).map(lambda xy: complex(*xy))


@given(st.lists(POINTS.filter(bool), min_size=1, max_size=25, unique=True))
def test_so_has_any_other_set_of_slots(slots: list[complex]) -> None:
    check_graph([0j, *slots])


@given(st.lists(POINTS.filter(bool), min_size=1, max_size=25, unique=True))
def test_no_edge_is_longer_than_needed(slots: list[complex]) -> None:
    everyone = [0j, *slots]
    graph = measured(everyone).graph
    reach = max(abs(everyone[j] - everyone[i]) for i, js in enumerate(graph.neighbours) for j in js)
    shorter = Graph(
        tuple(
            tuple(j for j in range(len(everyone)) if 0.0 < abs(everyone[j] - everyone[i]) < reach * 0.999)
            if i else ()
            for i in range(len(everyone))
        )
    )  # fmt: skip
    assert any(hops is None or hops > MAX_HOPS for hops in shorter.depths)


def test_graph_is_independent_of_size_and_rounding() -> None:
    for name in NAMES:
        small, large = SHAPES[name](23, 0.5), SHAPES[name](23, 8.0)
        rounded = [complex(round(slot.real, 6), round(slot.imag, 6)) for slot in small]
        assert measured([0j, *small]) == measured([0j, *large]) == measured([0j, *rounded])


def test_generated_patrol_graph_equals_the_handmade_one() -> None:
    from formation.mission.file import load

    mission = load("patrol")
    names, found = mission.names, measured(mission.slots())
    for i, name in enumerate(names[1:], 1):
        assert tuple(names[j] for j in found.neighbours[i]) == mission.robots[name].neighbours
        assert tuple(names[j] for j in found.fallbacks[i]) == mission.robots[name].fallback_neighbours
