"""Says the messages of a recording again, byte for byte, each on its key under another prefix."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from formation.mission import Mission
from formation.topics import EVENTS, Topic
from formation.wire import Sample
from monitor.figures.keys import OWN, watched

Advertise = Callable[[Topic, str], None]
Publish = Callable[[str, bytes, bytes | None], None]


class Echo:
    """Where the messages of one mission go."""

    def __init__(self, mission: Mission, prefix: str, advertise: Advertise, publish: Publish) -> None:
        """`advertise` and `publish` are a bus's; every key that the mission has is declared now.

        A bus that waits for slow listeners loses nothing: then it is the player that falls behind.
        """
        self.said = 0
        self._prefix, self._advertise, self._publish = prefix, advertise, publish
        self._keys: set[str] = set()
        for one in (*watched(mission), *OWN):
            self._declare(one.topic, one.key)

    @property
    def keys(self) -> Iterable[str]:
        """Every key that is declared, with its prefix."""
        return self._keys

    def say(self, sample: Sample) -> None:
        """Say it again."""
        key = f"{self._prefix}/{sample.key}"
        if key not in self._keys:  # recorded by a monitor that knew more than this one
            self._declare(EVENTS, sample.key)
        self._publish(key, sample.payload, sample.attachment)
        self.said += 1

    def _declare(self, topic: Topic, key: str) -> None:
        self._advertise(topic, f"{self._prefix}/{key}")
        self._keys.add(f"{self._prefix}/{key}")
