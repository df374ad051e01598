"""The history in a recording: the monitor's events, the leader's orders, and what each robot did."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.core import MIN_CLOCK_STEP
from formation.monitor.metrics.event import Event, from_message
from formation.monitor.metrics.events import silence_limit
from formation.monitor.metrics.orders import OrderedMotion, Orders
from formation.monitor.metrics.snapshot import SIGHT, RobotMetrics
from formation.monitor.recording.reader import Recorded
from formation.protocol.order import Mode
from formation.ros2.messages import Diagnostics, LogEntry, decode
from formation.topics import DIAGNOSTICS, EVENTS
from formation.wire import BadMessage, Now

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
    motion: OrderedMotion
    leads: str
    """Name of the candidate that gave it."""


class ClockStep(NamedTuple):
    """The recorder's system clock was set."""

    at: float
    """When [s, that clock as if it had not been set]."""
    step: float
    """By how much [s]."""


class Story:
    """Collect the history."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.orders: list[Ordered] = []
        self.unlisted = 0
        """Number of events not kept."""
        self.clock_steps: list[ClockStep] = []
        self.elapsed_excess = math.nan
        """Excess of the monitor's own elapsed time since it was first published [s]; NaN before that."""
        self._ahead = 0.0  # system clock before what it would be, had it not been set [s]
        self._first_excess = math.nan

    def process_message(self, message: Recorded, start: float | None) -> None:
        """Take an event, or compare the monitor's own elapsed time with that since `start` [s].

        The live one is on the monotonic clock, which is not in a recording.
        """
        key, payload, now = message.sample.key, message.sample.payload, message.now
        self._follow_clock(now)
        with suppress(BadMessage, LookupError, ValueError):
            if key == EVENTS.key():
                event = from_message(decode(LogEntry, payload))
                self._add(event._replace(at=event.at - self._ahead))
            elif key == DIAGNOSTICS.key() and start is not None:
                self._compare(decode(Diagnostics, payload), now.mono - start)

    def _follow_clock(self, now: Now) -> None:
        ahead = now.wall - now.mono
        if abs(ahead - self._ahead) >= MIN_CLOCK_STEP and len(self.clock_steps) < MAX_EVENTS:
            self.clock_steps.append(ClockStep(now.mono, ahead - self._ahead))
        self._ahead = ahead

    def _compare(self, diagnostics: Diagnostics, elapsed: float) -> None:
        excess = float(diagnostics.statuses[0].values["elapsed"]) - elapsed
        if math.isnan(self._first_excess):
            self._first_excess = excess
        self.elapsed_excess = excess - self._first_excess

    def _add(self, event: Event) -> None:
        if len(self.events) < MAX_EVENTS:
            self.events.append(event)
        else:
            self.unlisted += 1

    def look(self, at: float, orders: Orders) -> None:
        """Note a change of the order by `at` [s]."""
        order, lead = orders.newest, orders.lead
        if order is None or len(self.orders) >= MAX_EVENTS:
            return
        wanted = order.mode, OrderedMotion.of(order), lead.name if lead else ""
        if not self.orders or self.orders[-1][1:] != wanted:
            self.orders.append(Ordered(at, *wanted))


@dataclass(slots=True)
class Activity:
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


class Activities:
    """Times of all robots. Call `look` steadily."""

    def __init__(self, mission: Mission) -> None:
        self.each = {name: Activity() for name in mission.followers}
        self._limits = {name: silence_limit(mission.robots[name].rate) for name in mission.followers}
        self._unavailable = dict.fromkeys(mission.followers, False)
        self._deadlocks = dict.fromkeys(mission.followers, 0)
        self._looked = float("inf")

    def look(self, at: float, robots: Mapping[str, RobotMetrics]) -> None:
        """Account for the states of all robots at `at` [s]."""
        passed = at - self._looked
        self._looked = at
        if all(self._lost(name, robots[name]) for name in self.each):
            passed = 0.0  # before the run, or after it
        for name, activity in self.each.items():
            robot = robots[name]
            activity.starts = max(robot.publishers - 1, 0)
            activity.times_unavailable += robot.unavailable and not self._unavailable[name]
            self._unavailable[name] = robot.unavailable
            activity.deadlocks += max(0, robot.deadlocks - self._deadlocks[name])
            self._deadlocks[name] = robot.deadlocks
            if robot.age is None or not 0.0 < passed <= MAX_LOOK_GAP:
                continue
            state = robot.state if robot.state in STATES else OTHER
            state = LOST_STATE if self._lost(name, robot) else state
            activity.seconds[state] = activity.seconds.get(state, 0.0) + passed
            activity.unavailable += passed * robot.unavailable
            activity.fallback += passed * bool(robot.fallback)
            activity.avoiding += passed * (robot.avoiding in {"avoids", "slowed"})
            activity.blocked += passed * (robot.avoiding == "blocked")
            activity.unseeing += passed * (robot.sight in SIGHT)
            activity.correction = max(activity.correction, robot.correction or 0.0)

    def _lost(self, name: str, robot: RobotMetrics) -> bool:
        return robot.age is None or robot.age > self._limits[name]
