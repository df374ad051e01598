"""What is said again: byte for byte, under another prefix, on keys that are declared before."""

from __future__ import annotations

from formation.mission_file import load
from formation.topics import EVENTS, POSITION, Topic
from formation.wire import Sample
from monitor.figures.keys import OWN, watched
from monitor.replay.echo import Echo

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


def test_a_message_is_said_as_it_was_with_what_rode_on_it() -> None:
    air = Air()
    echo = Echo(SIX, "a/b", air.advertise, air.publish)
    echo.say(Sample(POSITION.key("robot2"), b"\x00\xff", b"order", 1.0))
    echo.say(Sample(POSITION.key("robot2"), b"", None, 2.0))
    assert air.said == [("a/b/robot2/position", b"\x00\xff", b"order"), ("a/b/robot2/position", b"", None)]
    assert echo.said == 2


def test_a_key_that_this_monitor_does_not_know_is_said_all_the_same() -> None:
    air = Air()
    echo = Echo(SIX, "replay", air.advertise, air.publish)
    for _ in range(2):
        echo.say(Sample("robot9/novelty", b"x", None, 1.0))
    assert air.declared["replay/robot9/novelty"] is EVENTS
    assert len(air.said) == 2
