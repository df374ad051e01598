"""Where the monitor looks for simulated robots."""

from __future__ import annotations

import pytest

from formation.mission.file import load, parse, read
from formation.monitor.metrics.keys import given_stage, usual_stage
from formation.transport import wiring


def test_by_default_they_are_where_formation_robot_puts_them() -> None:
    mission = load("six_robots")
    assert usual_stage(mission) == wiring.endpoints(mission).robots


def test_robot_with_endpoint_in_mission_is_not_simulated() -> None:
    text, name = read("turtlebot3_pair")
    real = '[robots.robot1]\nrobot_endpoint = "tcp/127.0.0.1:7447"'
    mission = parse(text.replace("[robots.robot1]", real), name)
    assert list(usual_stage(mission)) == ["robot2"]


def test_one_endpoint_is_where_all_are() -> None:
    mission = load("turtlebot3_pair")
    assert given_stage(mission, ["tcp/127.0.0.1:9"]) == dict.fromkeys(mission.followers, "tcp/127.0.0.1:9")


def test_some_robots_can_be_put_behind_one_endpoint_and_others_nowhere() -> None:
    mission = load("six_robots")
    found = given_stage(mission, ["robot2,robot3=tcp/127.0.0.1:8", "robot4=tls/desk:9?so_sndbuf=1"])
    assert found == {
        "robot2": "tcp/127.0.0.1:8", "robot3": "tcp/127.0.0.1:8", "robot4": "tls/desk:9?so_sndbuf=1",
    }  # fmt: skip


def test_an_endpoint_may_have_an_equals_sign_of_its_own() -> None:
    mission = load("turtlebot3_pair")
    assert set(given_stage(mission, ["tcp/desk:9#iface=lo"]).values()) == {"tcp/desk:9#iface=lo"}


@pytest.mark.parametrize("name", ["robot9", "leader", ""])
def test_unknown_simulated_robot_is_refused_with_possible_names(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name!r} must be a follower of turtlebot3-pair: robot1, robot2"):
        given_stage(load("turtlebot3_pair"), [f"robot1,{name}=tcp/desk:9"])
