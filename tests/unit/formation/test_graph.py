"""The graph of neighbours, and what can still be followed when a robot is lost."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.control.arrays import ComplexArray
from formation.mission.file import load, shipped
from formation.mission.graph import Graph
from formation.mission.model import Mission
from formation.simulation.edges import Edges, edge_errors, formation_error
from formation.stability.losses import Loss, followed, leads, losing, losses, useless_fallbacks
from tests.support.examples import examples
from tests.support.missions import team, teams
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


CHAIN = {"a": ["leader"], "b": ["a"], "c": ["b"]}


def standing(loss: Loss) -> set[str]:
    return set(loss.holding)


def test_robots_behind_a_lost_one_hold() -> None:
    found = losses(team(CHAIN))
    assert {name: set(loss.holding) for name, loss in found.items()} == {
        "leader": {"a", "b", "c"},
        "a": {"b", "c"},
        "b": {"c"},
        "c": set(),
    }


@pytest.mark.parametrize(
    ("neighbours", "fallbacks", "instead"),
    [
        ({"a": ["leader"], "b": ["leader"], "c": ["a", "b"]}, {}, {}),
        (CHAIN, {"b": ["leader"]}, {"b": ("leader",)}),
        (
            {"a": ["leader"], "b": ["a"], "c": ["a"]},
            {"b": ["leader"], "c": ["b"]},
            {"b": ("leader",), "c": ("b",)},
        ),
    ],
    ids=["second neighbour", "fallback", "fallback led by a fallback"],
)
def test_robots_behind_a_lost_one_go_on_by_others(
    neighbours: dict[str, list[str]], fallbacks: dict[str, list[str]], instead: dict[str, tuple[str, ...]]
) -> None:
    mission = team(neighbours, fallbacks)
    assert losing(mission, "a") == Loss((), instead)
    assert followed(mission, "c", {"a"}) == ("b",)


def test_mutual_fallbacks_both_hold() -> None:
    mission = team({"a": ["leader"], "b": ["a"], "c": ["a"]}, {"b": ["c"], "c": ["b"]})
    assert standing(losing(mission, "a")) == {"b", "c"}


def test_a_neighbour_that_follows_only_me_is_no_guide() -> None:
    mission = team({"a": ["leader"], "b": ["a", "c"], "c": ["b"]})
    assert standing(losing(mission, "a")) == {"b", "c"}
    assert followed(mission, "b", {"a"}) == ()
    assert followed(mission, "b", ()) == ("a", "c")


def test_the_leaders_silence_is_no_proof_of_its_death() -> None:
    mission = team({"a": ["leader"], "b": ["leader"]}, {"a": ["b"]})
    assert followed(mission, "a", {"leader"}) == ("b",)
    assert standing(losing(mission, "leader")) == {"a", "b"}


def test_fallbacks_that_never_help_are_named_and_others_are_not() -> None:
    mission = team(CHAIN, {"a": ["b"], "b": ["c"], "c": ["a"]})
    found = list(useless_fallbacks(mission))
    assert len(found) == 2
    assert found[0].startswith("robots.a.fallback_neighbours: b never helps")
    assert found[1].startswith("robots.b.fallback_neighbours: c never helps")


@pytest.mark.parametrize("name", shipped())
def test_in_a_mission_without_a_loss_all_follow_all_their_neighbours(name: str) -> None:
    mission = load(name)
    for robot in mission.followers:
        assert followed(mission, robot, ()) == mission.robots[robot].neighbours


def least(mission: Mission, lost: str) -> set[str]:
    """The robots with a path to the leader over neighbours and fallbacks."""
    led = {mission.leader} - {lost}
    while more := {
        name for name in mission.followers if name != lost and name not in led
        and led.intersection(mission.robots[name].measurable)
    }:  # fmt: skip
        led |= more
    return led


@examples(300)
@given(teams(), st.data())
def test_continuing_robots_always_have_a_path_without_cycle(mission: Mission, data: st.DataObject) -> None:
    lost = data.draw(st.sampled_from(mission.followers))
    loss = losing(mission, lost)
    going = {name for name in mission.followers if name != lost} - standing(loss)
    assert going <= least(mission, lost)
    assert set(loss.instead) <= going
    gone = {lost, *loss.holding}
    for name in going:
        assert followed(mission, name, gone)
        assert gone.isdisjoint(followed(mission, name, gone))


@pytest.mark.slow
@settings(max_examples=300)
@given(teams(cycles=False), st.data())
def test_without_cycles_every_robot_with_neighbour_continues(mission: Mission, data: st.DataObject) -> None:
    lost = data.draw(st.sampled_from(mission.followers))
    going = set(mission.followers) - standing(losing(mission, lost)) - {lost}
    backwards: Mapping[str, int] = {name: number for number, name in enumerate(mission.names)}
    straight = all(
        backwards[other] < backwards[name]
        for name in mission.followers
        for other in mission.robots[name].measurable
    )
    if straight:
        assert going == least(mission, lost) - {mission.leader}


@given(teams())
def test_chain_to_leader_survives_fewer_losses(mission: Mission) -> None:
    for name in mission.followers:
        for other in mission.robots[name].neighbours:
            if leads(mission, other, name, ()):
                continue
            assert not leads(
                mission, other, name, [one for one in mission.followers if one not in (name, other)]
            )
