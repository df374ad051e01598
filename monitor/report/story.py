"""The history in a recording: the monitor's events, the leader's orders, and what each robot did."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.metrics.event import Event, from_message
from formation.monitor.metrics.events import silence_limit
from formation.monitor.metrics.orders import Orders, Wish
from formation.monitor.metrics.snapshot import SIGHT, RobotMetrics
from formation.protocol.order import Mode
from formation.ros2.messages import Diagnostics, LogEntry, decode
from formation.topics import DIAGNOSTICS, EVENTS
from formation.wire import BadMessage

SETTLED = b"settled_at"
MAX_EVENTS = 2000
"""Most events, and changes of the order, that are kept; more are only counted."""
MAX_LOOK_GAP = 1.0
"""Longest time between two looks that is attributed to a state [s]."""
STATES = ("run", "hold", "stop", "waiting")
LOST_STATE, OTHER = "lost", "other"


class Ordered(NamedTuple):
    """The leader's order from this moment on."""

    at: float
    """[s, the recorder's clock]"""
    mode: Mode
    wish: Wish
    leads: str
    """Name of the candidate that gave it."""


class Story:
    """Collect the history."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.orders: list[Ordered] = []
        self.unlisted = 0
        """Number of events not kept."""
        self.apart = math.nan
        """Excess of the settling time last published by the monitor [s]; NaN if none was."""

    def process_message(self, key: str, payload: bytes, settled_at: float | None) -> None:
        """Take an event, or compare the monitor's published settling time with `settled_at`, found now [s].

        The live one is on the monotonic clock, which is not in a recording.
        """
        with suppress(BadMessage, IndexError, ValueError):
            if key == EVENTS.key():
                self._add(from_message(decode(LogEntry, payload)))
            elif key == DIAGNOSTICS.key() and settled_at is not None and SETTLED in payload:
                values = decode(Diagnostics, payload).statuses[0].values
                self.apart = float(values.get("settled_at", "nan")) - settled_at

    def _add(self, event: Event) -> None:
        if len(self.events) < MAX_EVENTS:
            self.events.append(event)
        else:
            self.unlisted += 1

    def look(self, wall: float, orders: Orders) -> None:
        """Note a change of the order by `wall` [s]."""
        order, lead = orders.newest, orders.lead
        if order is None or len(self.orders) >= MAX_EVENTS:
            return
        wanted = order.mode, Wish.of(order), lead.name if lead else ""
        if not self.orders or self.orders[-1][1:] != wanted:
            self.orders.append(Ordered(wall, *wanted))


@dataclass(slots=True)
class Doing:
    """One robot's times by activity."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Time by state [s]: one of `STATES`, ``lost`` while it was not received, ``other``."""
    unavailable: float = 0.0
    """Time in which it was unavailable, and others went on without it [s]."""
    fallback: float = 0.0
    """Time in which it measured fallback neighbours [s]."""
    avoiding: float = 0.0
    """Time in which it avoided others, or its protective zone slowed it [s]."""
    blocked: float = 0.0
    """Time in which its protective zone stopped it [s]."""
    unseeing: float = 0.0
    """Time in which it had to see its neighbours, and did not [s]."""
    correction: float = 0.0
    """Largest correction of its odometry by its scans [m]."""
    deadlocks: int = 0
    """Number of deadlocks that it resolved."""
    times_unavailable: int = 0
    """Number of times that it became unavailable."""
    starts: int = 0
    """Number of publishers of its positions after the first."""


class Doings:
    """Times of all robots. Call `look` steadily."""

    def __init__(self, mission: Mission) -> None:
        self.each = {name: Doing() for name in mission.followers}
        self._limits = {name: silence_limit(mission.robots[name].rate) for name in mission.followers}
        self._unavailable = dict.fromkeys(mission.followers, False)
        self._deadlocks = dict.fromkeys(mission.followers, 0)
        self._looked = float("inf")

    def look(self, wall: float, robots: Mapping[str, RobotMetrics]) -> None:
        """Account for the states of all robots at `wall` [s]."""
        passed = wall - self._looked
        self._looked = wall
        if all(self._lost(name, robots[name]) for name in self.each):
            passed = 0.0  # before the run, or after it
        for name, doing in self.each.items():
            robot = robots[name]
            doing.starts = max(robot.publishers - 1, 0)
            doing.times_unavailable += robot.unavailable and not self._unavailable[name]
            self._unavailable[name] = robot.unavailable
            doing.deadlocks += max(0, robot.deadlocks - self._deadlocks[name])
            self._deadlocks[name] = robot.deadlocks
            if robot.age is None or not 0.0 < passed <= MAX_LOOK_GAP:
                continue
            state = robot.state if robot.state in STATES else OTHER
            state = LOST_STATE if self._lost(name, robot) else state
            doing.seconds[state] = doing.seconds.get(state, 0.0) + passed
            doing.unavailable += passed * robot.unavailable
            doing.fallback += passed * bool(robot.fallback)
            doing.avoiding += passed * (robot.avoiding in {"avoids", "slowed"})
            doing.blocked += passed * (robot.avoiding == "blocked")
            doing.unseeing += passed * (robot.sight in SIGHT)
            doing.correction = max(doing.correction, robot.correction or 0.0)

    def _lost(self, name: str, robot: RobotMetrics) -> bool:
        return robot.age is None or robot.age > self._limits[name]
