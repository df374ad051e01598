"""Publish the messages of a recording again, byte for byte, each on its key under another prefix.

The prefix is never the first word of a key that a robot may receive. A robot subscribes to its own keys and
to no wildcard at their beginning, so a first word that occurs nowhere on the live network keeps the replay
away from all robots, however they are linked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN, watched
from formation.ros2.naming import Naming
from formation.topics import EVENTS, TABLE, Topic
from formation.wire import Sample

Advertise = Callable[[Topic, str], None]
Publish = Callable[[str, bytes, bytes | None], None]
DEFAULT = "replay"
_WORDS = re.compile(r"[^\s/*$?#@]+(/[^\s/*$?#@]+)*")


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


def checked(prefix: str, mission: Mission) -> str:
    """Return `prefix` if no message under it can be taken for live. Raises ValueError."""
    if not _WORDS.fullmatch(prefix):
        raise ValueError(f"{prefix!r}: must be words joined by '/', without * $ ? # @, such as {DEFAULT}")
    first = prefix.partition("/")[0]
    if first == mission.team:
        raise ValueError(f"{prefix!r}: is how the live keys of the team {first!r} begin; name another word")
    if first in set(_beginnings(mission)):
        raise ValueError(f"{prefix!r}: live keys begin with {first!r} as well; name another word")
    return prefix


def _beginnings(mission: Mission) -> Iterator[str]:
    """Yield the first word of every key with live messages, on either side of an agent."""
    yield from mission.names
    yield from (topic.pattern.partition("/")[0] for topic in TABLE if "{" not in topic.pattern)
    for name in mission.followers:
        naming = Naming.of(mission.robots, [name])
        places = (*naming.robots.values(), naming.formation)
        yield from (naming.wire(key).partition("/")[0] for place in places for key in place.logical_keys())
