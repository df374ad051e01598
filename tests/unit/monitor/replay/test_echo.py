"""What a replay publishes: the same bytes under a prefix that nothing live begins with."""

from __future__ import annotations

from typing import Any

import pytest

from formation.mission.file import load, shipped
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.replay.echo import DEFAULT, Echo, checked
from formation.topics import EVENTS, POSITION, Topic
from formation.wire import Sample

SIX = load("six_robots")


class Air:
    """What a bus would have been told."""

    def __init__(self) -> None:
        self.declared: dict[str, Topic] = {}
        self.said: list[tuple[str, bytes, bytes | None]] = []

    def advertise(self, topic: Topic, key: str) -> None:
        assert key not in self.declared
        self.declared[key] = topic

    def publish(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        assert key in self.declared
        self.said.append((key, payload, attachment))


def test_every_key_of_the_mission_is_declared_with_its_own_topic() -> None:
    air = Air()
    echo = Echo(SIX, "replay", air.advertise, air.publish)
    assert air.declared == {f"replay/{one.key}": one.topic for one in (*watched(SIX), *OWN)}
    assert set(echo.keys) == set(air.declared)


def test_message_is_republished_with_its_attachment() -> None:
    air = Air()
    echo = Echo(SIX, "a/b", air.advertise, air.publish)
    echo.publish(Sample(POSITION.key("robot2"), b"\x00\xff", b"order", 1.0))
    echo.publish(Sample(POSITION.key("robot2"), b"", None, 2.0))
    assert air.said == [("a/b/robot2/position", b"\x00\xff", b"order"), ("a/b/robot2/position", b"", None)]
    assert echo.published == 2


def test_unknown_key_is_republished() -> None:
    air = Air()
    echo = Echo(SIX, "replay", air.advertise, air.publish)
    for _ in range(2):
        echo.publish(Sample("robot9/novelty", b"x", None, 1.0))
    assert air.declared["replay/robot9/novelty"] is EVENTS
    assert len(air.said) == 2


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
        checked(prefix, SIX.model_copy(update={"team": "red"}))


@pytest.mark.parametrize(
    ("keys", "prefix"), [({"ros": "rmw_zenoh", "domain": 7}, "7"), ({"namespace": "hall"}, "hall")]
)
def test_how_ros_spells_keys_is_refused(keys: dict[str, Any], prefix: str) -> None:
    robots = {name: robot.model_copy(update=keys) for name, robot in SIX.robots.items()}
    mission = SIX.model_copy(update={"robots": robots})
    assert checked("8", mission) == "8"
    with pytest.raises(ValueError, match=f"live keys begin with '{prefix}'"):
        checked(prefix, mission)
