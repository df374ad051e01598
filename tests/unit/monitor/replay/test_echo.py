"""What is said again: byte for byte, under another prefix, on keys that are declared before."""

from __future__ import annotations

from formation.mission.file import load
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.replay.echo import Echo
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
