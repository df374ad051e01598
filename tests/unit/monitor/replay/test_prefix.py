"""What a recording may be played under: nothing that begins as anything live does."""

from __future__ import annotations

import pytest

from formation.mission.file import load, shipped
from formation.mission.model import Mission
from formation.monitor.replay.echo import DEFAULT, checked

SIX = load("six_robots")
RED = SIX.model_copy(update={"team": "red"})


def in_ros(mission: Mission, **changes: object) -> Mission:
    """The mission with a ROS of another kind on every robot."""
    robots = {name: robot.model_copy(update=changes) for name, robot in mission.robots.items()}
    return mission.model_copy(update={"robots": robots})


@pytest.mark.parametrize("mission", shipped())
@pytest.mark.parametrize("prefix", [DEFAULT, "monday", "a/b", "red"])
def test_a_word_that_nothing_live_begins_with_will_do(mission: str, prefix: str) -> None:
    assert checked(prefix, load(mission)) == prefix


@pytest.mark.parametrize(
    "prefix", ["", "/", "/a", "a/", "a//b", "a b", "*", "a/**", "a$b", "a?b", "a#b", "@"]
)
def test_what_is_no_key_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="must be words joined by"):
        checked(prefix, SIX)


@pytest.mark.parametrize("prefix", ["robot2", "robot1", "formation", "robot2/replay", "formation/replay"])
def test_what_live_keys_begin_with_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="live keys begin with"):
        checked(prefix, SIX)


@pytest.mark.parametrize("prefix", ["red", "red/replay"])
def test_the_team_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="the team 'red'"):
        checked(prefix, RED)


def test_how_ros_spells_keys_is_refused() -> None:
    mission = in_ros(SIX, ros="rmw_zenoh", domain=7)
    assert checked("8", mission) == "8"
    with pytest.raises(ValueError, match="live keys begin with '7'"):
        checked("7", mission)
    namespaced = in_ros(SIX, namespace="hall")
    with pytest.raises(ValueError, match="live keys begin with 'hall'"):
        checked("hall", namespaced)
