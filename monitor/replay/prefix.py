"""Prefix of a replay's keys: never the first word of a key that a robot may receive.

A robot subscribes to its own keys and to no wildcard at their beginning, so a first word that occurs nowhere
on the live network keeps the replay away from all robots, however they are linked.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from formation.mission.model import Mission
from formation.ros2.naming import Naming
from formation.topics import TABLE

DEFAULT = "replay"
_WORDS = re.compile(r"[^\s/*$?#@]+(/[^\s/*$?#@]+)*")


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
