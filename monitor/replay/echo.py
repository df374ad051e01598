"""Publish the messages of a recording again, byte for byte, each on its key under another prefix."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN, watched
from formation.topics import EVENTS, Topic
from formation.wire import Sample

Advertise = Callable[[Topic, str], None]
Publish = Callable[[str, bytes, bytes | None], None]


class Echo:
    """Publisher of one mission's messages."""

    def __init__(self, mission: Mission, prefix: str, advertise: Advertise, publish: Publish) -> None:
        """`advertise` and `publish` are a bus's; every key of the mission is declared now.

        If the bus waits for slow listeners, nothing is lost and the player falls behind instead.
        """
        self.published = 0
        self._prefix, self._advertise, self._publish = prefix, advertise, publish
        self._keys: set[str] = set()
        for one in (*watched(mission), *OWN):
            self._declare(one.topic, one.key)

    @property
    def keys(self) -> Iterable[str]:
        """Every declared key, with its prefix."""
        return self._keys

    def publish(self, sample: Sample) -> None:
        """Publish a recorded message."""
        key = f"{self._prefix}/{sample.key}"
        if key not in self._keys:  # recorded by a monitor that knew more than this one
            self._declare(EVENTS, sample.key)
        self._publish(key, sample.payload, sample.attachment)
        self.published += 1

    def _declare(self, topic: Topic, key: str) -> None:
        self._advertise(topic, f"{self._prefix}/{key}")
        self._keys.add(f"{self._prefix}/{key}")
