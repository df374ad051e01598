"""The events of a formation, in words: snapshots in, events out, without a clock.

An event is a change from one snapshot to the next. Frequent events (a robot at the limit of radio range, an
error at the bound, invalid messages) are reported a few times at once and then occasionally, with a count, so
that the list stays readable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from formation.mission.model import Mission
from formation.monitor.metrics.event import ERROR, INFO, WARNING, Event, RateLimit, Reported
from formation.monitor.metrics.feed import freshness_limit
from formation.monitor.metrics.orders import Lead, OrderedMotion
from formation.monitor.metrics.snapshot import (
    AVOIDING,
    SIGHT,
    CandidateMetrics,
    ReportedRequest,
    RobotMetrics,
    Snapshot,
)
from formation.monitor.metrics.statuses import LEADS, SILENT
from formation.protocol.order import DRIVEN_ROUTE
from formation.wire import Now

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
DRIFTED_DISTANCE = 0.1
"""Correction of odometry by scans that is reported [m]."""
CLEAR_TIME = 2.0
"""How long no obstacle limits a robot's command until it no longer counts as avoiding [s]."""
START_TIME = 5.0
"""How long a robot that has not run yet may hold before that is an event [s]: links, odometry and neighbours
come one after another."""
ROUTE_ID_CHARS = 8
"""Characters of an ordered route's id that are shown: enough to tell routes apart."""
STANDBY = "standby"
"""State of a candidate that does not lead."""


class Events:
    """Changes from snapshot to snapshot. Call `collect_events` steadily, several times a second."""

    def __init__(self, mission: Mission) -> None:
        self._robots = [_Robot(name, mission.robots[name].rate) for name in mission.names]
        self._leading = _Leading(mission)
        self._settled = _Settled(mission.settled)
        self._rejected = _Rejected(mission)

    def collect_events(self, now: Now, snapshot: Snapshot) -> list[Event]:
        """Return the events since the last call."""
        found = list(self._leading.collect_events(now, snapshot))
        for robot in self._robots:
            found += robot.collect_events(now, snapshot)
        found += self._settled.collect_events(now, snapshot)
        found += self._rejected.collect_events(now, snapshot)
        return found


class _Robot:
    """Events of one robot: presence, state, and publishers of its position."""

    def __init__(self, name: str, rate: float) -> None:
        self.name = name
        self._limit = silence_limit(rate)
        self._joined, self._gone_since = False, 0.0
        self._missing_since = math.inf  # since when others are received, and this one is not [s, monotonic]
        self._absence_reported = False
        self._presence, self._state, self._publishers = Reported("lost"), Reported(), Reported("one process")
        self._availability, self._fallback, self._process = Reported("follows"), Reported(), Reported("1")
        self._stuck, self._deadlocks, self._relays = Reported("moves"), Reported("0"), Reported("true")
        self._avoiding, self._avoided = Reported("clear"), -math.inf  # and when it last did [s, monotonic]
        self._sees, self._drifted = Reported(), Reported("False")
        self._ran = self._followed = False
        self._holds_since = math.inf

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        robot = snapshot.robots[self.name]
        if not self._joined:
            yield from self._absence_event(now, snapshot)
        yield from self._presence_events(now, robot)
        yield from self._state_events(now, robot)
        yield from self._following_events(now, robot)
        yield from self._obstacle_events(now, robot)
        yield from self._sight_events(now, robot)
        contested = self.name in snapshot.contested
        publishers = "two processes" if contested else "one process"
        if (more := self._publishers.report(publishers, now.mono)) is not None:
            text = f"its positions come from {publishers}{more}"
            yield Event(now.wall, ERROR if contested else INFO, self.name, "contested", text)
        forges = self.name in snapshot.forgers
        if (more := self._relays.report("forged" if forges else "true", now.mono)) is not None:
            text = "no longer relays forged orders"
            if forges:
                text = "relays forged orders: others refuse them; take it out of the mission, or stop it"
            yield Event(now.wall, ERROR if forges else INFO, self.name, "forged", text + more)

    def _absence_event(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        """Yield one event if nothing is received of this robot though others are there."""
        others = any(one.age is not None for one in snapshot.robots.values())
        self._missing_since = _since(others, self._missing_since, now.mono)
        if not self._absence_reported and now.mono - self._missing_since >= START_TIME:
            self._absence_reported = True
            text = f"no position received yet, {START_TIME:g} s after the first of another robot"
            yield Event(now.wall, WARNING, self.name, "absent", text)

    def _presence_events(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        lost = robot.age is None or robot.age > self._limit
        if lost and robot.age is not None and self._presence.state != "lost":
            self._gone_since = now.mono - robot.age
        away = now.mono - self._gone_since
        if (more := self._presence.report("lost" if lost else "there", now.mono)) is None:
            return
        if lost:
            stands = self._state.state in {"hold", "stop"}
            last_state = f"; last state: {self._state.state}" if self._state.state else ""
            text = f"silent for {robot.age:.1f} s{last_state}{more}"
            yield Event(now.wall, WARNING if stands else ERROR, self.name, "lost", text)
        elif self._joined:
            yield Event(now.wall, INFO, self.name, "back", f"after {away:.1f} s of silence{more}")
        else:
            yield Event(now.wall, INFO, self.name, "joined", f"its position is received{more}")
        self._joined = True

    def _state_events(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        kind, level = STATES.get(robot.state, ("", 0))
        if not kind:  # silent or unseen: its missing position is reported instead
            return
        self._ran = self._ran or kind not in {"held", "waiting"}
        self._holds_since = _since(kind == "held", self._holds_since, now.mono)
        if kind == "held" and not self._ran and now.mono - self._holds_since < START_TIME:
            return  # it is starting
        if (more := self._state.report(robot.shown, now.mono)) is not None:
            watching = "read only: " if robot.readonly else ""
            text = f"{watching}{robot.reason or robot.state}{more}"
            yield Event(now.wall, level, self.name, kind, text)

    def _following_events(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        """Yield events about whether it is followed, and which robots it measures."""
        if (more := self._process.report(str(max(robot.publishers, 1)), now.mono)) is not None:
            text = f"another process publishes its positions from here on{more}"
            yield Event(now.wall, WARNING, self.name, "restarted", text)
        available = "unavailable" if robot.unavailable else "follows"
        if (more := self._availability.report(available, now.mono)) is not None:
            level, text = INFO, "it follows, and is followed, again"
            if robot.unavailable and self._followed:
                why = "" if robot.state == "run" else f": {robot.reason or robot.state}"
                level, text = WARNING, f"does not follow, others go on without it{why}"
            elif robot.unavailable:
                text = "on its way to its slot, others go on without it until it is there"
            yield Event(now.wall, level, self.name, self._availability.state, text + more)
        starting = robot.age is None or robot.state in {"waiting", "hold"}
        self._followed = self._followed or not (starting or robot.unavailable)
        if (more := self._stuck.report("stuck" if robot.stuck else "moves", now.mono)) is not None:
            level, text = (WARNING, "does not move as commanded") if robot.stuck else (INFO, "moves again")
            yield Event(now.wall, level, self.name, "stuck", text + more)
        if (more := self._fallback.report(robot.fallback, now.mono)) is not None:
            level, text = INFO, "its own neighbours are back"
            if robot.fallback:
                level, text = WARNING, f"none of its own neighbours is left, it follows {robot.fallback}"
            yield Event(now.wall, level, self.name, "fallback", text + more)

    def _obstacle_events(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        if robot.avoiding:
            self._avoided = now.mono
        state = "blocked" if robot.avoiding == "blocked" else "avoiding" if robot.avoiding else "clear"
        if state == "clear" and now.mono - self._avoided < CLEAR_TIME:
            state = self._avoiding.state
        if (more := self._avoiding.report(state, now.mono)) is not None:
            text = AVOIDING.get(robot.avoiding, "no obstacle limits its command any more")
            level = WARNING if state == "blocked" else INFO
            yield Event(now.wall, level, self.name, state, text + more)
        more = self._deadlocks.report(str(robot.deadlocks), now.mono)
        if more is not None and robot.deadlocks:
            text = f"resolves a deadlock by another way ({robot.deadlocks} so far){more}"
            yield Event(now.wall, INFO, self.name, "deadlock", text)

    def _sight_events(self, now: Now, robot: RobotMetrics) -> Iterator[Event]:
        """Yield events about sight of its neighbours, and about odometry that scans have corrected."""
        if (more := self._sees.report(robot.sight, now.mono)) is not None and robot.sight:
            text = SIGHT.get(robot.sight) or "sees its neighbours: " + ", ".join(
                f"{name} to {deviation * 1e3:.0f} mm" for name, deviation in robot.seen.items()
            )
            yield Event(now.wall, WARNING if robot.sight in SIGHT else INFO, self.name, "sight", text + more)
        drifted = str((robot.correction or 0.0) > DRIFTED_DISTANCE)
        if (more := self._drifted.report(drifted, now.mono)) is not None and drifted == "True":
            text = f"odometry alone would be off by {robot.correction:.2f} m; scans correct it{more}"
            yield Event(now.wall, WARNING, self.name, "drift", text)


class _Settled:
    """Whether the formation is settled; an error that only touches the bound is tolerated."""

    def __init__(self, bound: float) -> None:
        self._bound = bound
        self._stands = False
        self._over_since = self._restless_since = math.inf
        self._turns = Reported("unsettled")

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        self._over_since = _since(snapshot.settled_at is None, self._over_since, now.mono)
        self._restless_since = _since(not snapshot.converged, self._restless_since, now.mono)
        over, restless = now.mono - self._over_since, now.mono - self._restless_since
        if snapshot.converged:
            self._stands = True
        elif over >= UNSETTLED_TIME or restless >= RESTLESS_TIME:
            self._stands = False
        more = self._turns.report("settled" if self._stands else "unsettled", now.mono)
        if more is None:
            return
        bound = f"{self._bound * 1e3:.0f} mm"
        if self._stands:
            after = snapshot.settling_time if snapshot.ordered_at else None
            after_order = "" if after is None else f", {after:.1f} s after what was ordered last"
            # it may touch the bound just when this is reported
            since = "" if snapshot.settled_at is None else f" since {snapshot.settled_at:.1f} s"
            yield Event(
                now.wall, INFO, "", "settled", f"under the bound of {bound}{since}{after_order}{more}"
            )
            return
        known, level, text = snapshot.known, WARNING, "the error is not known"
        if not snapshot.formed:
            level, text = INFO, "another shape is on its way"
        elif known.error is not None and known.complete:
            text = f"error {known.error * 1e3:.0f} mm, bound {bound}"
        elif known.error is not None:
            text = (
                f"error not known over all edges; {known.error * 1e3:.0f} mm on {known.words}; bound {bound}"
            )
        yield Event(now.wall, level, "", "unsettled", text + more)


class _Rejected:
    """Rejected messages: the first of a kind at once, then only their number."""

    def __init__(self, mission: Mission) -> None:
        self._names = frozenset(mission.names)
        self._reported: dict[str, int] = {}
        self._next: dict[str, float] = {}
        self._pace = RateLimit(MAX_REJECTION_KINDS, REJECTION_PERIOD / MAX_REJECTION_KINDS)

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        due = [
            what
            for what, count in snapshot.rejected.items()
            if count > self._reported.get(what, 0) and now.mono >= self._next.get(what, now.mono)
        ]
        for what in sorted(due, key=lambda one: self._next.get(one, 0.0)):  # longest waiting first
            if not self._pace.allows(now.mono):
                return
            count = snapshot.rejected[what] - self._reported.get(what, 0)
            self._reported[what], self._next[what] = snapshot.rejected[what], now.mono + REJECTION_PERIOD
            robot = what.partition("/")[0]
            text = f"{what} ({count} messages)" if count > 1 else what
            yield Event(now.wall, WARNING, robot if robot in self._names else "", "rejected", text)


def _since(is_so: bool, since: float, at: float) -> float:
    """Return since when `is_so` holds [s]; infinite while it does not."""
    return min(since, at) if is_so else math.inf


def silence_limit(rate: float) -> float:
    """Return the silence [s] after which a robot of `rate` [Hz] is lost."""
    return max(LOST_SILENCE, freshness_limit(rate))


def ordered_in_words(ordered: OrderedMotion) -> str:
    """Return the order in words; rotation and scale are left out if they are as drawn."""
    parts = [f"shape {ordered.shape}"]
    if ordered.rotation:
        parts.append(f"turned by {math.degrees(ordered.rotation):.4g}°")
    if ordered.scale != 1.0:
        parts.append(f"{ordered.scale:.4g} times as large")
    if ordered.route:
        driven = ordered.route == DRIVEN_ROUTE
        parts.append("driven by hand" if driven else f"on ordered route {ordered.route[:ROUTE_ID_CHARS]}")
    return ", ".join(parts)


class _Leading:
    """Events about orders, the shape and the leader."""

    def __init__(self, mission: Mission) -> None:
        self._agreed = bool(mission.standbys)
        self._order, self._formed, self._waits = Reported(), Reported("formed"), Reported("goes on")
        self._lead: Lead | None = None
        self._reported = 0  # number of the newest reported request
        self._candidates = {name: Reported() for name in mission.candidates} if self._agreed else {}

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        yield from self._leader_event(now, snapshot.lead)
        yield from self._request_events(now, snapshot.requests)
        yield from self._order_events(now, snapshot)
        yield from self._waiting_event(now, snapshot)
        if snapshot.leads is not None:
            yield from self._candidate_events(now, snapshot.candidates)

    def _leader_event(self, now: Now, lead: Lead | None) -> Iterator[Event]:
        if lead is None or (self._lead is not None and lead.term == self._lead.term):
            return
        self._lead = lead
        leader = lead.name or "a process that the mission does not know"
        if not lead.before:
            if self._agreed:
                yield Event(now.wall, INFO, leader, "leader", "leads")
        elif lead.name == lead.before:
            text = f"leads again, after {lead.silent:.1f} s without a leader"
            yield Event(now.wall, WARNING, leader, "leader", text)
        else:
            text = f"leads from here on, {lead.before} was silent for {lead.silent:.1f} s"
            yield Event(now.wall, WARNING, leader, "leader", text)

    def _request_events(self, now: Now, requests: Sequence[ReportedRequest]) -> Iterator[Event]:
        for one in requests:
            if one.number > self._reported:
                self._reported = one.number
                answer = "obeys" if one.ok else "refuses"
                text = f"{one.what}; it {answer}{': ' if one.reason else ''}{one.reason}"
                yield Event(now.wall, INFO if one.ok else WARNING, one.name, "requested", text)

    def _order_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        if snapshot.mode is None or snapshot.ordered is None:
            return
        ordered = f"{snapshot.mode}, {ordered_in_words(snapshot.ordered)}"
        if snapshot.tuned:
            ordered += f", {snapshot.tuned.words}"
        if (more := self._order.report(ordered, now.mono)) is not None:
            level = INFO if snapshot.mode == "run" else WARNING
            yield Event(now.wall, level, "", "order", f"the leader orders {ordered}{more}")
        more = self._formed.report("formed" if snapshot.formed else "on its way", now.mono)
        if more is not None and snapshot.formed:
            took = snapshot.elapsed - snapshot.ordered_at
            text = f"the slots are where they are wanted, {took:.1f} s after that was ordered{more}"
            yield Event(now.wall, INFO, "", "formed", text)

    def _waiting_event(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        if (more := self._waits.report("waits" if snapshot.waits else "goes on", now.mono)) is not None:
            text = f"waits for {snapshot.waits}" if snapshot.waits else "no longer waits"
            level = WARNING if snapshot.waits else INFO
            yield Event(now.wall, level, "", "waits", f"the leader {text}{more}")

    def _candidate_events(self, now: Now, candidates: Mapping[str, CandidateMetrics]) -> Iterator[Event]:
        for name, one in candidates.items():
            if one.state not in {STANDBY, SILENT, LEADS}:
                continue
            more = self._candidates[name].report(one.state, now.mono)
            if more is None or one.state == LEADS:
                continue
            if one.state == STANDBY:
                yield Event(now.wall, INFO, name, "standby", f"stands by{more}")
            else:
                yield Event(now.wall, WARNING, name, "lost", f"cannot take over: {one.reason}{more}")
