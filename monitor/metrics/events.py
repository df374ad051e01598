"""The events of a formation, in words: snapshots in, events out, without a clock.

An event is a change between two looks. Frequent events (a robot at the edge of the radio, an error at the
bound, rubbish) are reported a few times at once and then occasionally, with a count, so that the list stays
readable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from formation.mission.model import Mission
from formation.monitor.metrics.event import (
    ERROR,
    FORMATION,
    INFO,
    MAX_STAMP,
    MAX_TEXT_CHARS,
    WARNING,
    Event,
    from_message,
    more,
    to_message,
)
from formation.monitor.metrics.feed import freshness_limit
from formation.monitor.metrics.leading import Leading
from formation.monitor.metrics.snapshot import AVOIDING, RobotMetrics, Snapshot
from formation.monitor.metrics.turns import Pace, Turns
from formation.wire import Now

__all__ = [
    "ERROR", "FORMATION", "INFO", "LOST_SILENCE", "MAX_REJECTION_KINDS", "MAX_STAMP", "MAX_TEXT_CHARS",
    "REJECTION_PERIOD", "STATES", "WARNING", "Event", "Events", "from_message", "to_message",
]  # fmt: skip
LOST_SILENCE = 1.0
"""A robot is lost when its position is silent for longer [s]; one with a low rate has its own limit."""
UNSETTLED_TIME = 1.0
"""How long the error is over the bound, or unknown, until the formation counts as unsettled [s]."""
RESTLESS_TIME = 5.0
"""How long the error goes over the bound repeatedly until the formation counts as unsettled [s]."""
REJECTION_PERIOD = 10.0
"""Shortest time between two events about rejected messages of one kind [s]."""
MAX_REJECTION_KINDS = 8
"""Number of kinds of rejected messages that are reported within `REJECTION_PERIOD`."""
STATES = {
    "run": ("runs", INFO),
    "hold": ("held", WARNING),
    "stop": ("stopped", WARNING),
    "waiting": ("waiting", INFO),
}
"""The event for each state of an agent (or the leader)."""
CLEAR_TIME = 2.0
"""How long no obstacle limits a robot's command until it no longer counts as avoiding [s]."""
START_TIME = 5.0
"""How long a robot that has not run yet may hold before that is an event [s]: links, odometry and neighbours
come one after another."""


class Events:
    """Changes from look to look. Call `collect_events` steadily, several times a second."""

    def __init__(self, mission: Mission) -> None:
        self._robots = [_Robot(name, mission.robots[name].rate) for name in mission.names]
        self._leading = Leading(mission)
        self._settled = _Settled(mission.settled)
        self._rejected = _Rejected(mission)

    def collect_events(self, now: Now, snapshot: Snapshot) -> list[Event]:
        """Return the events since the last look."""
        found = list(self._leading.collect_events(now, snapshot))
        for robot in self._robots:
            found += robot.collect_events(now, snapshot.robots[robot.name], robot.name in snapshot.contested)
            found += robot.relaying(now, forges=robot.name in snapshot.forgers)
        found += self._settled.collect_events(now, snapshot)
        found += self._rejected.collect_events(now, snapshot)
        return found


class _Robot:
    """Events of one robot: presence, state, and publishers of its position."""

    def __init__(self, name: str, rate: float) -> None:
        self.name = name
        self._limit = max(LOST_SILENCE, freshness_limit(rate))
        self._joined, self._gone_since = False, 0.0
        self._presence, self._state, self._publishers = Turns("lost"), Turns(), Turns("one publisher")
        self._availability, self._fallback, self._process = Turns("follows"), Turns(), Turns("1")
        self._stuck = Turns("moves")
        self._avoiding, self._avoided = Turns("clear"), -math.inf  # and when it last did [s, monotonic]
        self._deadlocks = Turns("0")
        self._relays = Turns("true")
        self._ran = self._followed = False
        self._holds_since = math.inf

    def collect_events(self, now: Now, robot: RobotMetrics, contested: bool) -> Iterator[Event]:
        yield from self._there(now, robot)
        yield from self._doing(now, robot)
        yield from self._following(now, robot)
        yield from self._obstacles(now, robot)
        before = self._publishers.update_state(
            "a second publisher" if contested else "one publisher", now.mono
        )
        if before is not None:
            level = ERROR if contested else INFO
            text = f"its neighbours receive messages of {self._publishers.state}{more(before)}"
            yield Event(now.wall, level, self.name, "contested", text)

    def relaying(self, now: Now, *, forges: bool) -> Iterator[Event]:
        """Yield events about forged orders that it relays."""
        before = self._relays.update_state("forged" if forges else "true", now.mono)
        if before is not None:
            level, text = (
                (ERROR, "relays forged orders: others refuse them; take it out of the mission, or stop it")
                if forges
                else (INFO, "relays no forged orders any more")
            )
            yield Event(now.wall, level, self.name, "forged", f"{text}{more(before)}")

    def _there(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        lost = robot.age is None or robot.age > self._limit
        if lost and robot.age is not None and self._presence.state != "lost":
            self._gone_since = now.mono - robot.age
        away = now.mono - self._gone_since
        before = self._presence.update_state("lost" if lost else "there", now.mono)
        if before is None:
            return
        if lost:
            stands = self._state.state in {"hold", "stop"}
            last_state = f"; last state: {self._state.state}" if self._state.state else ""
            text = f"silent for {robot.age:.1f} s{last_state}{more(before)}"
            yield Event(now.wall, WARNING if stands else ERROR, self.name, "lost", text)
        elif self._joined:
            yield Event(now.wall, INFO, self.name, "back", f"after {away:.1f} s of silence{more(before)}")
        else:
            yield Event(now.wall, INFO, self.name, "joined", f"its position is received{more(before)}")
        self._joined = True

    def _doing(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        kind, level = STATES.get(robot.state, ("", 0))
        if not kind:  # silent or unseen: reported by its position
            return
        self._ran = self._ran or kind not in {"held", "waiting"}
        self._holds_since = _since(kind == "held", self._holds_since, now.mono)
        if kind == "held" and not self._ran and now.mono - self._holds_since < START_TIME:
            return  # it is starting
        before = self._state.update_state(robot.shown, now.mono)
        if before is not None:
            watching = "read only: " if robot.readonly else ""
            text = f"{watching}{robot.reason or robot.state}{more(before)}"
            yield Event(now.wall, level, self.name, kind, text)

    def _following(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        """Yield events about whether it is followed, and which robots it measures."""
        before = self._process.update_state(str(max(robot.publishers, 1)), now.mono)
        if before is not None:
            text = f"another process publishes its positions from here on{more(before)}"
            yield Event(now.wall, WARNING, self.name, "restarted", text)
        before = self._availability.update_state("unavailable" if robot.unavailable else "follows", now.mono)
        if before is not None:
            why = "" if robot.state == "run" else f": {robot.reason or robot.state}"
            level, text = INFO, "it follows, and is followed, again"
            if robot.unavailable and self._followed:
                level, text = WARNING, f"does not follow, others go on without it{why}"
            elif robot.unavailable:
                text = "on its way to its slot, others go on without it until it is there"
            yield Event(now.wall, level, self.name, self._availability.state, f"{text}{more(before)}")
        starting = robot.age is None or robot.state in {"waiting", "hold"}
        self._followed = self._followed or not (starting or robot.unavailable)
        before = self._stuck.update_state("stuck" if robot.stuck else "moves", now.mono)
        if before is not None:
            level, text = (WARNING, "does not move as commanded") if robot.stuck else (INFO, "moves again")
            yield Event(now.wall, level, self.name, "stuck", f"{text}{more(before)}")
        before = self._fallback.update_state(robot.fallback, now.mono)
        if before is not None:
            level, text = INFO, "its own neighbours are back"
            if robot.fallback:
                level, text = WARNING, f"none of its own neighbours is left, it follows {robot.fallback}"
            yield Event(now.wall, level, self.name, "fallback", f"{text}{more(before)}")

    def _obstacles(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        """Yield events about obstacles to its motion."""
        if robot.avoiding:
            self._avoided = now.mono
        state = "blocked" if robot.avoiding == "blocked" else "avoiding" if robot.avoiding else "clear"
        if state == "clear" and now.mono - self._avoided < CLEAR_TIME:
            state = self._avoiding.state
        before = self._avoiding.update_state(state, now.mono)
        if before is not None:
            level = WARNING if state == "blocked" else INFO
            text = AVOIDING.get(robot.avoiding, "no obstacle limits its command any more")
            yield Event(now.wall, level, self.name, state, f"{text}{more(before)}")
        before = self._deadlocks.update_state(str(robot.deadlocks), now.mono)
        if before is not None and robot.deadlocks:
            text = f"kept from moving, it goes another way ({robot.deadlocks} so far){more(before)}"
            yield Event(now.wall, INFO, self.name, "deadlock", text)


class _Settled:
    """Whether the formation is settled; an error that only touches the bound is tolerated."""

    def __init__(self, bound: float) -> None:
        self._bound = bound
        self._stands = False
        self._over_since = self._restless_since = math.inf
        self._turns = Turns("unsettled")

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        self._over_since = _since(snapshot.settled_at is None, self._over_since, now.mono)
        self._restless_since = _since(not snapshot.converged, self._restless_since, now.mono)
        over, restless = now.mono - self._over_since, now.mono - self._restless_since
        if snapshot.converged:
            self._stands = True
        elif over >= UNSETTLED_TIME or restless >= RESTLESS_TIME:
            self._stands = False
        before = self._turns.update_state("settled" if self._stands else "unsettled", now.mono)
        if before is not None:
            yield self._event(now, snapshot, more(before))

    def _event(self, now: Now, snapshot: Snapshot, more: str) -> Event:
        bound = f"the bound of {self._bound * 1e3:.0f} mm"
        known = snapshot.known
        if self._stands:
            after = snapshot.settling_time if snapshot.wished_at else None
            wished = "" if after is None else f", {after:.1f} s after what was ordered last"
            # it may touch the bound just when this is reported
            since = "" if snapshot.settled_at is None else f" since {snapshot.settled_at:.1f} s"
            text = f"under {bound}{since}{wished}{more}"
            return Event(now.wall, INFO, "", "settled", text)
        if not snapshot.formed:
            return Event(now.wall, INFO, "", "unsettled", f"another shape is on its way{more}")
        is_now = "the error is not known"
        if known.error is not None:
            over = "" if known.complete else f" over {known.words}"
            is_now = f"error {known.error * 1e3:.0f} mm{over}, {bound}"
        return Event(now.wall, WARNING, "", "unsettled", f"{is_now}{more}")


class _Rejected:
    """Rejected messages: the first of a kind at once, then only their number."""

    def __init__(self, mission: Mission) -> None:
        self._names = frozenset(mission.names)
        self._reported: dict[str, int] = {}
        self._next: dict[str, float] = {}
        self._pace = Pace(MAX_REJECTION_KINDS, REJECTION_PERIOD / MAX_REJECTION_KINDS)

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        due = [
            what
            for what, count in snapshot.rejected.items()
            if count > self._reported.get(what, 0) and now.mono >= self._next.get(what, now.mono)
        ]
        for what in sorted(due, key=lambda one: self._next.get(one, 0.0)):  # longest waiting first
            if not self._pace.may(now.mono):
                return
            count = snapshot.rejected[what] - self._reported.get(what, 0)
            self._reported[what], self._next[what] = snapshot.rejected[what], now.mono + REJECTION_PERIOD
            robot = what.partition("/")[0]
            text = f"{what} ({count} messages)" if count > 1 else what
            yield Event(now.wall, WARNING, robot if robot in self._names else "", "rejected", text)


def _since(is_so: bool, since: float, at: float) -> float:
    """Return since when `is_so` holds [s]; infinite while it does not."""
    return min(since, at) if is_so else math.inf
