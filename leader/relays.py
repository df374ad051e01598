"""How late the leader's orders reach robots, by the leader's own clock: from the beat that each relays.

A delay that is constant from the start of a term does not show in arrivals, and by its stamp it looks like a
wrong clock. A relayed beat has gone to the robot and back, over all hops, so its age bounds the delay.
"""

from __future__ import annotations

import math
from typing import NamedTuple

MAX_RELAY_AGE = 1.5
"""Age of relayed orders on arrival beyond which the leader is not driven by hand [s]."""
LASTING_TIME = 1.0
"""Time for which they must be older [s]: a burst of late messages is no constant delay."""


class Relay(NamedTuple):
    """The newest beat that one robot has relayed."""

    beat: int
    age: float
    """[s]"""
    arrived: float
    """[s, monotonic]"""
    since: float
    """Since when all were older than `MAX_RELAY_AGE` [s, monotonic]; infinite if this one is not."""


class Relays:
    """The newest relayed beats of one term, by robot."""

    def __init__(self) -> None:
        self._newest: dict[str, Relay] = {}

    def begin(self) -> None:
        """Forget all: another term begins, with beats from one on."""
        self._newest.clear()

    def receive(self, robot: str, beat: int, sent: float, arrived: float) -> None:
        """Take the beat of an order that was `sent` [s, monotonic]; only a newer one counts."""
        before = self._newest.get(robot, Relay(0, 0.0, arrived, math.inf))
        if beat > before.beat:
            age = arrived - sent
            since = min(before.since, arrived) if age > MAX_RELAY_AGE else math.inf
            self._newest[robot] = Relay(beat, age, arrived, since)

    def late(self, moment: float) -> str:
        """Return which robot relays orders that are too old at `moment` [s, monotonic]; empty if none does.

        Robots without a recent beat are left out: they hold by themselves.
        """
        late = {
            robot: one.age
            for robot, one in self._newest.items()
            if moment - one.since >= LASTING_TIME and moment - one.arrived <= LASTING_TIME
        }
        if not late:
            return ""
        robot = max(late, key=late.__getitem__)
        age, limit = late[robot], MAX_RELAY_AGE
        return f"{robot} relays its orders {age:.1f} s old; limit {limit:g} s; check its links"
