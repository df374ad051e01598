"""Messages that a replay publishes: the same bytes, under a prefix that no live key has."""

from __future__ import annotations

from typing import Any

import pytest

from formation.mission.file import load, shipped
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.replay.echo import DEFAULT, Echo, checked
from formation.topics import EVENTS, POSITION, Topic
from formation.wire import Sample

SIX = load("six_robots")


class FakeBus:
    """A bus that keeps what is declared and published."""

    def __init__(self) -> None:
        self.declared: dict[str, Topic] = {}
        self.sent: list[tuple[str, bytes, bytes | None]] = []

    def advertise(self, topic: Topic, key: str) -> None:
        assert key not in self.declared
        self.declared[key] = topic

    def publish(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        assert key in self.declared
        self.sent.append((key, payload, attachment))


def test_every_key_is_declared_with_its_topic() -> None:
    bus = FakeBus()
    Echo(SIX, "replay", bus.advertise, bus.publish)
    assert bus.declared == {f"replay/{one.key}": one.topic for one in (*watched(SIX), *OWN)}


def test_message_is_republished_with_its_attachment() -> None:
    bus = FakeBus()
    echo = Echo(SIX, "a/b", bus.advertise, bus.publish)
    echo.publish(Sample(POSITION.key("robot2"), b"\x00\xff", b"order", 1.0))
    echo.publish(Sample(POSITION.key("robot2"), b"", None, 2.0))
    assert bus.sent == [("a/b/robot2/position", b"\x00\xff", b"order"), ("a/b/robot2/position", b"", None)]
    assert echo.published == 2


def test_unknown_key_is_republished() -> None:
    bus = FakeBus()
    echo = Echo(SIX, "replay", bus.advertise, bus.publish)
    for _ in range(2):
        echo.publish(Sample("robot9/novelty", b"x", None, 1.0))
    assert bus.declared["replay/robot9/novelty"] is EVENTS
    assert len(bus.sent) == 2


@pytest.mark.parametrize("mission", shipped())
@pytest.mark.parametrize("prefix", [DEFAULT, "monday", "a/b", "red"])
def test_prefix_that_no_live_key_has_is_accepted(mission: str, prefix: str) -> None:
    assert checked(prefix, load(mission)) == prefix


@pytest.mark.parametrize(
    "prefix", ["", "/", "/a", "a/", "a//b", "a b", "*", "a/**", "a$b", "a?b", "a#b", "@"]
)
def test_invalid_prefix_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="must be words joined by"):
        checked(prefix, SIX)


@pytest.mark.parametrize("prefix", ["robot2", "robot1", "formation", "robot2/replay", "formation/replay"])
def test_prefix_of_live_keys_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="live keys begin with"):
        checked(prefix, SIX)


@pytest.mark.parametrize("prefix", ["red", "red/replay"])
def test_team_as_prefix_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="the team 'red'"):
        checked(prefix, SIX.model_copy(update={"team": "red"}))


@pytest.mark.parametrize(
    ("keys", "prefix"), [({"ros": "rmw_zenoh", "domain": 7}, "7"), ({"namespace": "hall"}, "hall")]
)
def test_ros_domain_or_namespace_as_prefix_is_refused(keys: dict[str, Any], prefix: str) -> None:
    robots = {name: robot.model_copy(update=keys) for name, robot in SIX.robots.items()}
    mission = SIX.model_copy(update={"robots": robots})
    assert checked("8", mission) == "8"
    with pytest.raises(ValueError, match=f"live keys begin with '{prefix}'"):
        checked(prefix, mission)
