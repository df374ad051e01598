"""The measurement graph, and which neighbours can be followed when a robot is lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.control.arrays import ComplexArray
from formation.mission.graph import Graph
from formation.mission.model import Mission
from formation.simulation.edges import Edges, edge_errors, formation_error
from formation.stability.losses import Loss, followed, leads, losing, losses, useless_fallbacks
from tests.support.examples import examples
from tests.support.missions import team, teams
from tests.unit.formation.planar import headings, vectors


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


@given(graphs(), st.data())
def test_sum_per_follower_equals_laplacian_times_points(graph: Graph, data: st.DataObject) -> None:
    edges, stack = Edges(graph), np.stack([shape(data, graph), shape(data, graph)])
    sums = edges.sum_per_follower(edges.along_edges(stack))
    assert sums == pytest.approx(-(stack @ edges.laplacian().T)[:, 1:], abs=1e-9)


@given(graphs(), vectors, headings, st.data())
def test_formation_error_is_invariant_to_translation_and_rotation(
    graph: Graph, away: complex, turn: complex, data: st.DataObject
) -> None:
    edges, points, slots = Edges(graph), shape(data, graph), shape(data, graph)
    error = formation_error(edges, points, slots)
    assert formation_error(edges, points + away, slots) == pytest.approx(error)
    assert formation_error(edges, turn * points, turn * slots) == pytest.approx(error)
    assert edge_errors(edges, points, slots).sum() == pytest.approx(error)


@given(graphs())
def test_depth_counts_hops_to_the_leader(graph: Graph) -> None:
    assert graph.unreachable == ()
    assert graph.depths[0] == 0
    for i in range(1, graph.size):
        nearest = min(depth for j in graph.neighbours[i] if (depth := graph.depths[j]) is not None)
        assert graph.depths[i] == nearest + 1


@given(graphs(), st.data())
def test_eigenvalues_are_positive_only_with_spanning_tree(graph: Graph, data: st.DataObject) -> None:
    assert np.linalg.eigvals(Edges(graph).follower_laplacian()).real.min() > 0.0
    cut_off = data.draw(st.integers(1, graph.size - 1))
    lost = Graph(tuple(() if i == cut_off else js for i, js in enumerate(graph.neighbours)))
    assert cut_off in lost.unreachable
    assert abs(np.linalg.eigvals(Edges(lost).follower_laplacian())).min() == pytest.approx(0.0, abs=1e-9)


CHAIN = {"a": ["leader"], "b": ["a"], "c": ["b"]}


def test_all_robots_behind_a_lost_robot_hold() -> None:
    found = {name: "".join(loss.holding) for name, loss in losses(team(CHAIN)).items()}
    assert found == {"leader": "abc", "a": "bc", "b": "c", "c": ""}


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
def test_robots_behind_a_lost_robot_follow_other_neighbours(
    neighbours: dict[str, list[str]], fallbacks: dict[str, list[str]], instead: dict[str, tuple[str, ...]]
) -> None:
    mission = team(neighbours, fallbacks)
    assert losing(mission, "a") == Loss((), instead)
    assert followed(mission, "c", {"a"}) == ("b",)


def test_robots_with_mutual_fallbacks_both_hold() -> None:
    mission = team({"a": ["leader"], "b": ["a"], "c": ["a"]}, {"b": ["c"], "c": ["b"]})
    assert losing(mission, "a").holding == ("b", "c")


def test_robot_does_not_follow_neighbour_that_follows_only_it() -> None:
    mission = team({"a": ["leader"], "b": ["a", "c"], "c": ["b"]})
    assert losing(mission, "a").holding == ("b", "c")
    assert followed(mission, "b", {"a"}) == ()
    assert followed(mission, "b", ()) == ("a", "c")


def test_fallback_replaces_silent_leader_but_not_lost_leader() -> None:
    mission = team({"a": ["leader"], "b": ["leader"]}, {"a": ["b"]})
    assert followed(mission, "a", {"leader"}) == ("b",)
    assert losing(mission, "leader").holding == ("a", "b")


def test_useless_fallbacks_names_only_fallbacks_that_never_help() -> None:
    mission = team(CHAIN, {"a": ["b"], "b": ["c"], "c": ["a"]})
    first, second = useless_fallbacks(mission)
    assert first.startswith("robots.a.fallback_neighbours: b never helps")
    assert second.startswith("robots.b.fallback_neighbours: c never helps")


def connected(mission: Mission, lost: str) -> set[str]:
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
def test_continuing_robots_have_path_and_follow_continuing_robots(
    mission: Mission, data: st.DataObject
) -> None:
    lost = data.draw(st.sampled_from(mission.followers))
    loss = losing(mission, lost)
    going = {name for name in mission.followers if name != lost} - {*loss.holding}
    assert going <= connected(mission, lost)
    assert set(loss.instead) <= going
    gone = {lost, *loss.holding}
    for name in going:
        assert followed(mission, name, gone)
        assert gone.isdisjoint(followed(mission, name, gone))


@pytest.mark.slow
@settings(max_examples=300)
@given(teams(cycles=False), st.data())
def test_robots_with_remaining_path_continue_in_acyclic_missions(
    mission: Mission, data: st.DataObject
) -> None:
    lost = data.draw(st.sampled_from(mission.followers))
    going = set(mission.followers) - {*losing(mission, lost).holding} - {lost}
    assert going == connected(mission, lost) - {mission.leader}


@given(teams())
def test_neighbour_that_does_not_lead_stays_so_with_losses(mission: Mission) -> None:
    for name in mission.followers:
        for other in mission.robots[name].neighbours:
            if not leads(mission, other, name, ()):
                others = [one for one in mission.followers if one not in (name, other)]
                assert not leads(mission, other, name, others)
