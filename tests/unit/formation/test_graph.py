from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.arrays import ComplexArray
from formation.mission.graph import Graph
from formation.simulation.edges import Edges, edge_errors, formation_error
from tests.unit.formation.planar import angles, vectors


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    """Directed graphs with a spanning tree: each follower measures one robot before it, and some others."""
    size = draw(st.integers(2, 8))
    neighbours: list[tuple[int, ...]] = [()]
    for i in range(1, size):
        others = draw(st.sets(st.integers(0, size - 1), max_size=3))
        neighbours.append(tuple(sorted((others | {draw(st.integers(0, i - 1))}) - {i})))
    return Graph(tuple(neighbours))


def shape(draw_from: st.DataObject, graph: Graph) -> ComplexArray:
    return np.array([0j, *(draw_from.draw(vectors) for _ in range(graph.size - 1))])


@given(graphs())
def test_rows_of_the_laplacian_sum_to_zero(graph: Graph) -> None:
    assert Edges(graph).laplacian().sum(axis=1).tolist() == [0.0] * graph.size
    assert np.diag(Edges(graph).laplacian())[1:].tolist() == Edges(graph).degrees.tolist()


@given(graphs(), st.data())
def test_the_sparse_sum_is_the_laplacian_times_the_points(graph: Graph, data: st.DataObject) -> None:
    points = shape(data, graph)
    sparse = Edges(graph).sum_per_follower(Edges(graph).along_edges(points))
    assert sparse == pytest.approx((-Edges(graph).laplacian() @ points)[1:], abs=1e-9)


@given(graphs(), st.data())
def test_sums_go_over_the_last_axis_of_any_stack(graph: Graph, data: st.DataObject) -> None:
    stack = np.stack([shape(data, graph), shape(data, graph)])
    sums = Edges(graph).sum_per_follower(Edges(graph).along_edges(stack))
    assert sums.shape == (2, graph.size - 1)
    assert sums[1].tolist() == Edges(graph).sum_per_follower(Edges(graph).along_edges(stack[1])).tolist()


@given(graphs(), vectors, angles, st.data())
def test_the_formation_error_does_not_change_when_all_move_as_one(
    graph: Graph, away: complex, angle: float, data: st.DataObject
) -> None:
    points, slots = shape(data, graph), shape(data, graph)
    turn = np.exp(1j * angle)
    error = formation_error(Edges(graph), points, slots)
    assert formation_error(Edges(graph), points + away, slots) == pytest.approx(error)
    assert formation_error(Edges(graph), turn * points, turn * slots) == pytest.approx(error)
    assert edge_errors(Edges(graph), points, slots).sum() == pytest.approx(error)


@given(graphs())
def test_depth_counts_the_hops_to_the_leader(graph: Graph) -> None:
    assert graph.unreachable == ()
    assert graph.depths[0] == 0
    for i in range(1, graph.size):
        nearest = min(depth for j in graph.neighbours[i] if (depth := graph.depths[j]) is not None)
        assert graph.depths[i] == nearest + 1


@given(graphs(), st.data())
def test_with_a_spanning_tree_the_eigenvalues_have_positive_real_parts(
    graph: Graph, data: st.DataObject
) -> None:
    assert np.linalg.eigvals(Edges(graph).follower_laplacian()).real.min() > 0.0
    cut_off = data.draw(st.integers(1, graph.size - 1))
    neighbours = list(graph.neighbours)
    neighbours[cut_off] = ()
    lost = Graph(tuple(neighbours))
    assert cut_off in lost.unreachable
    assert abs(np.linalg.eigvals(Edges(lost).follower_laplacian())).min() == pytest.approx(0.0, abs=1e-9)


def test_robots_without_a_path_to_the_leader_have_no_depth() -> None:
    apart = Graph(((), (0,), (3,), (2,)))
    assert apart.unreachable == (2, 3)
    assert apart.depths == (0, 1, None, None)
