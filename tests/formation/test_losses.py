"""Who can still be followed when a robot is lost."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.mission import Mission
from formation.mission_file import load, shipped
from formation.stability.losses import Loss, followed, leads, losing, losses, useless_fallbacks
from tests.agent.missions import team, teams

CHAIN = {"a": ["leader"], "b": ["a"], "c": ["b"]}


def standing(loss: Loss) -> set[str]:
    return set(loss.holding)


def test_in_a_chain_everybody_behind_the_one_that_is_lost_holds() -> None:
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


def test_with_a_fallback_they_go_on_by_it_and_those_behind_them_as_before() -> None:
    mission = team(CHAIN, {"b": ["leader"]})
    assert losing(mission, "a") == Loss((), {"b": ("leader",)})
    assert followed(mission, "c", {"a"}) == ("b",)


def test_two_that_have_each_other_for_a_fallback_do_not_set_out_together() -> None:
    mission = team({"a": ["leader"], "b": ["a"], "c": ["a"]}, {"b": ["c"], "c": ["b"]})
    assert standing(losing(mission, "a")) == {"b", "c"}


def test_a_neighbour_that_follows_only_me_is_no_guide() -> None:
    mission = team({"a": ["leader"], "b": ["a", "c"], "c": ["b"]})
    assert standing(losing(mission, "a")) == {"b", "c"}
    assert followed(mission, "b", {"a"}) == ()
    assert followed(mission, "b", ()) == ("a", "c")


def test_a_fallback_that_is_itself_led_by_a_fallback_is_a_guide() -> None:
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
def test_nobody_goes_on_without_a_way_to_the_leader_and_without_cycles_everybody_does_who_has_one(
    mission: Mission, data: st.DataObject
) -> None:
    lost = data.draw(st.sampled_from(mission.followers))
    loss = losing(mission, lost)
    going = {name for name in mission.followers if name != lost} - standing(loss)
    assert going <= least(mission, lost)
    assert set(loss.instead) <= going
    gone = {lost, *loss.holding}
    for name in going:
        assert followed(mission, name, gone)
        assert gone.isdisjoint(followed(mission, name, gone))


@settings(max_examples=300)
@given(teams(cycles=False), st.data())
def test_where_no_way_leads_round_everybody_goes_on_who_has_a_neighbour_or_else_a_fallback_that_does(
    mission: Mission, data: st.DataObject
) -> None:
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
def test_who_leads_without_me_leads_also_when_fewer_are_lost(mission: Mission) -> None:
    for name in mission.followers:
        for other in mission.robots[name].neighbours:
            if leads(mission, other, name, ()):
                continue
            assert not leads(
                mission, other, name, [one for one in mission.followers if one not in (name, other)]
            )
