"""Who can still be followed when a robot is lost."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.mission.file import load, shipped
from formation.mission.model import Mission
from formation.stability.losses import Loss, followed, leads, losing, losses, useless_fallbacks
from tests.support.missions import team, teams

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


def test_with_a_second_neighbour_they_go_on() -> None:
    mission = team({"a": ["leader"], "b": ["leader"], "c": ["a", "b"]})
    assert losing(mission, "a") == Loss((), {})
    assert followed(mission, "c", {"a"}) == ("b",)


def test_fallback_replaces_lost_neighbour_for_robots_behind_it() -> None:
    mission = team(CHAIN, {"b": ["leader"]})
    assert losing(mission, "a") == Loss((), {"b": ("leader",)})
    assert followed(mission, "c", {"a"}) == ("b",)


def test_mutual_fallbacks_both_hold() -> None:
    mission = team({"a": ["leader"], "b": ["a"], "c": ["a"]}, {"b": ["c"], "c": ["b"]})
    assert standing(losing(mission, "a")) == {"b", "c"}


def test_a_neighbour_that_follows_only_me_is_no_guide() -> None:
    mission = team({"a": ["leader"], "b": ["a", "c"], "c": ["b"]})
    assert standing(losing(mission, "a")) == {"b", "c"}
    assert followed(mission, "b", {"a"}) == ()
    assert followed(mission, "b", ()) == ("a", "c")


def test_robot_led_by_fallback_can_serve_as_fallback() -> None:
    mission = team({"a": ["leader"], "b": ["a"], "c": ["a"]}, {"b": ["leader"], "c": ["b"]})
    assert losing(mission, "a") == Loss((), {"b": ("leader",), "c": ("b",)})


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
    """Who comes to the leader by any neighbours and fallbacks at all."""
    led = {mission.leader} - {lost}
    while more := {
        name for name in mission.followers if name != lost and name not in led
        and led.intersection(mission.robots[name].measurable)
    }:  # fmt: skip
        led |= more
    return led


@settings(max_examples=300)
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
