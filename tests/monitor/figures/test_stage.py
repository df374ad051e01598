"""Where the monitor looks for simulated robots."""

from __future__ import annotations

import pytest

from formation.mission_file import load, parse, read
from formation.transport import wiring
from monitor.figures.stage import given, usual


def test_by_default_they_are_where_formation_robot_puts_them() -> None:
    mission = load("six_robots")
    assert usual(mission) == wiring.endpoints(mission).robots


def test_a_robot_whose_router_the_mission_names_is_not_taken_for_a_simulated_one() -> None:
    text, name = read("turtlebot3_pair")
    real = '[robots.robot1]\nrobot_endpoint = "tcp/127.0.0.1:7447"'
    mission = parse(text.replace("[robots.robot1]", real), name)
    assert list(usual(mission)) == ["robot2"]


def test_one_endpoint_is_where_all_are() -> None:
    mission = load("turtlebot3_pair")
    assert given(mission, ["tcp/127.0.0.1:9"]) == dict.fromkeys(mission.followers, "tcp/127.0.0.1:9")


def test_some_robots_can_be_put_behind_one_endpoint_and_others_nowhere() -> None:
    mission = load("six_robots")
    found = given(mission, ["robot2,robot3=tcp/127.0.0.1:8", "robot4=tls/desk:9?so_sndbuf=1"])
    assert found == {
        "robot2": "tcp/127.0.0.1:8", "robot3": "tcp/127.0.0.1:8", "robot4": "tls/desk:9?so_sndbuf=1",
    }  # fmt: skip


def test_an_endpoint_may_have_an_equals_sign_of_its_own() -> None:
    mission = load("turtlebot3_pair")
    assert set(given(mission, ["tcp/desk:9#iface=lo"]).values()) == {"tcp/desk:9#iface=lo"}


@pytest.mark.parametrize("name", ["robot9", "leader", ""])
def test_a_robot_that_cannot_be_simulated_is_named_with_those_that_can(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name!r} must be a follower of turtlebot3-pair: robot1, robot2"):
        given(load("turtlebot3_pair"), [f"robot1,{name}=tcp/desk:9"])
