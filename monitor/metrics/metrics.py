"""The formation error and other metrics from the fleet's messages: bytes in, metrics out, without a clock.

Robots are sampled at different times, so all are interpolated to one moment before they are compared: the
newest that every fresh robot has reached. Values that depend on a silent robot are unknown; the known
edges are summed separately, with their number.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import partial

from formation.mission.model import Mission
from formation.monitor.metrics.feed import finite, freshness_limit
from formation.monitor.metrics.keys import Watched, watched
from formation.monitor.metrics.orders import OrderedMotion, Orders
from formation.monitor.metrics.received import Received, ReceivedOfRobot
from formation.monitor.metrics.settling import KnownError, KnownSettling, Settling
from formation.monitor.metrics.snapshot import Edge, Snapshot
from formation.monitor.metrics.statuses import Requests
from formation.monitor.metrics.trajectory import Placed
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.status import LeaderStatus
from formation.topics import POSITION
from formation.wire import BadMessage, Now, Sample

Errors = Mapping[Edge, float | None]
MAX_CLOCK_JUMP = 1.0
"""A larger jump of our system clock means that it was set [s]; a smaller one is ignored."""
MAX_REASONS = 64
"""Number of distinct reasons that are counted, as a faulty sender could cause any number."""
_NUMBER = re.compile(r"\d[\d.e+-]*")


class Rejections:
    """Counts by key and by reason."""

    def __init__(self) -> None:
        self.by_key: Counter[str] = Counter()
        self.by_reason: Counter[str] = Counter()
        """Counts by ``key: reason``."""

    def count(self, key: str, reason: str) -> None:
        """Count one message on `key`. Reasons that differ only in numbers are one."""
        self.by_key[key] += 1
        kind = f"{key}: {_NUMBER.sub('#', reason)[:120]}"
        if kind not in self.by_reason and len(self.by_reason) >= MAX_REASONS:
            kind = "other reasons"
        self.by_reason[kind] += 1


class Metrics:
    """Metrics of one mission's fleet."""

    def __init__(self, mission: Mission) -> None:
        self.rejections = Rejections()
        self._mission = mission
        self._edges = tuple(
            Edge(name, other) for name in mission.names for other in mission.robots[name].neighbours
        )
        self._requests = Requests()  # of operators
        slowest = max(freshness_limit(robot.rate) for robot in mission.robots.values())
        keys: dict[str, list[Watched]] = {}
        for one in watched(mission):
            keys.setdefault(one.robot, []).append(one)
        self._robots = {
            name: ReceivedOfRobot(mission, name, keys[name], self._requests, slowest)
            for name in mission.names
        }
        self._leader = self._robots[mission.leader]
        self._standbys = [Received(mission, name, keys[name], self._requests) for name in mission.standbys]
        self._candidates = {one.name: one.statuses for one in (self._leader, *self._standbys)}
        self._feeds_by_key = {
            key: (feed, handle)
            for one in (*self._robots.values(), *self._standbys)
            for key, feed, handle in one.feeds()
        }
        self.orders = Orders(mission, self._leader.place.trajectory.size)
        """The leader's orders."""
        for name, robot in self._robots.items():
            self._feeds_by_key[POSITION.key(name)] = robot.place.feed, partial(self._process_position, robot)
        self._ahead = math.inf  # our system clock before the monotonic one [s]
        self._settling = Settling(mission.settled, slowest)
        self._known = KnownSettling(mission.settled, slowest)

    def process_sample(self, sample: Sample, wall: float) -> None:
        """Take in one message that arrived at `wall` [s, our system clock]; count a bad one."""
        feed, handle = self._feeds_by_key.get(sample.key, (None, None))
        if feed is None:
            self.rejections.count("elsewhere", "unknown key")
            return
        self._follow_clock(wall - sample.arrived)
        feed.received(sample.arrived)
        try:
            if handle is not None:
                handle(sample, wall)
        except BadMessage as bad:
            self.rejections.count(sample.key, str(bad))
            feed.rejected = sample.arrived
            return
        feed.accepted = sample.arrived

    def observe(self, now: Now, *, known_only: bool = False) -> float | None:
        """Return the formation error of all robots at one moment [m]; None if unknown.

        Call it steadily: settling is judged at these moments only. With `known_only`, it is judged for the
        known edges only.
        """
        self._follow_clock(now.wall - now.mono)
        moment, errors = self._compare(now)
        error, formed = _sum_if_all_known(errors.values()), moment >= self.orders.formed_since
        at, last = moment + now.mono - now.wall, self._settling.last  # settling runs on the monotonic clock
        if error is not None and not known_only and (last is None or at > last):
            self._settling.observe(at, error, formed=formed)
        self._known.observe(at, self._known_error_now(errors, now), formed=formed)
        return error

    def snapshot(self, now: Now) -> Snapshot:
        """Return everything known now, without changing anything."""
        errors = self._compare(now)[1]
        start, until = self._settling.start, max(one.place.feed.accepted for one in self._robots.values())
        ordered, lead = self.orders.newest, self.orders.lead
        leads = lead.name if lead and self._leader.place.feed.fresh(now.mono) else None
        leader_state = self._candidates[leads].state(now) if leads else None
        newest = self._candidates[leads].newest(now) if leads else None
        own: dict[str, list[float | None]] = {}
        for edge, value in errors.items():
            own.setdefault(edge.robot, []).append(value)
        return Snapshot(
            elapsed=0.0 if start is None else now.mono - start,
            formation_error=_sum_if_all_known(errors.values()),
            known=self._known_error_now(errors, now),
            known_verdict=self._known.verdict(until, start),
            formation_error_true=_sum_if_all_known(self._compare(now, truly=True)[1].values()),
            settled_at=self._settling.settled_at(until),
            converged=self._settling.converged(until),
            final_error=self._settling.final(until),
            mode=ordered.mode if ordered else None,
            shape=ordered.shape if ordered else self._mission.first_shape,
            robots={
                name: robot.metrics(
                    now, KnownError.of(own.get(name, ())), leader_state if robot is self._leader else None
                )
                for name, robot in self._robots.items()
            },
            edges=errors,
            missed=sum(robot.missed() for robot in self._robots.values()),
            rejected=dict(self.rejections.by_reason),
            contested=frozenset(name for robot in self._robots.values() for name in robot.contested(now)),
            forgers=frozenset(name for robot in self._robots.values() for name in robot.forgers(now)),
            ordered=OrderedMotion.of(ordered) if ordered else None,
            ordered_at=self._settling.ordered_at,
            placed_shape=self.orders.placed_shape,
            formed=self.orders.formed,
            tuned=ordered.tuned if ordered else None,
            lead=lead,
            leads=leads,
            waits=", ".join(newest.waits_for) if isinstance(newest, LeaderStatus) else "",
            requests=tuple(self._requests.newest),
            candidates={
                name: one.candidate(now, leads=name == leads)
                for name, one in (self._candidates if self._standbys else {}).items()
            },
        )

    def placed(self, now: Now, *, truly: bool = False) -> tuple[float, dict[str, Placed]]:
        """Return the moment of comparison [s, our system clock], and the known places of robots at it.

        From the robots' own positions, or `truly`: from ground truth. Changes nothing.
        """
        tracked = {name: robot.truth if truly else robot.place for name, robot in self._robots.items()}
        fresh = [name for name, one in tracked.items() if one.feed.fresh(now.mono)]
        moment = min((tracked[name].trajectory.latest for name in fresh), default=-math.inf)
        places = {name: tracked[name].trajectory.at(moment) for name in fresh}
        return moment, {name: place for name, place in places.items() if place is not None}

    def missions(self, now: Now) -> dict[str, str]:
        """Return the fingerprints of the missions that robots and candidates say they run."""
        statuses = {name: robot.statuses for name, robot in self._robots.items()} | self._candidates
        newest = {name: one.newest(now) for name, one in statuses.items()}
        return {name: one.mission for name, one in newest.items() if one is not None and one.mission}

    def _follow_clock(self, ahead: float) -> None:
        """Forget all moments if our system clock was set; it is `ahead` [s] of the monotonic one now."""
        if abs(ahead - self._ahead) > MAX_CLOCK_JUMP:
            self.orders.forget()
            for one in (*self._robots.values(), *self._standbys):
                one.clock_was_set()
        self._ahead = ahead

    def _process_position(self, robot: ReceivedOfRobot, sample: Sample, wall: float) -> None:
        """Take in a position and its attachment. Raises BadMessage."""
        if robot is not self._leader:
            robot.process_position(sample, wall)
            if sample.attachment is not None:
                robot.attachments.process_attachment(sample.attachment, sample.arrived)
            return
        newest_order = None
        if sample.attachment is not None:
            newest_order = json_message.decode(PositionAttachment, sample.attachment).order
        if newest_order is not None and self.orders.admit(newest_order, sample.arrived, wall):
            robot.clock_was_set()  # another process publishes, perhaps on another machine
        robot.process_position(sample, wall)
        if newest_order is None:
            return
        moment = robot.place.trajectory.latest
        if self.orders.process_order(newest_order, moment, sample.arrived, wall):
            self._settling.restart(moment - self._ahead)
            self._known.restart(moment - self._ahead)

    def _compare(self, now: Now, *, truly: bool = False) -> tuple[float, Errors]:
        """Return the moment of comparison [s, our system clock], and each edge's |z_ij - z*_ij| [m]."""
        moment, placed = self.placed(now, truly=truly)
        slots = self.orders.slots(moment)

        def error(edge: Edge) -> float | None:
            here, there = placed.get(edge.robot), placed.get(edge.neighbour)
            if here is None or there is None:
                return None
            return abs(there.point - here.point - (slots[edge.neighbour] - slots[edge.robot]))

        return moment, {edge: error(edge) for edge in self._edges}

    def _known_error_now(self, errors: Errors, now: Now) -> KnownError:
        """Return the known error by the robots' own positions, and the silent robots."""
        placed = self.placed(now)[1]
        silent = {
            name: finite(robot.place.feed.silence(now.mono))
            for name, robot in self._robots.items()
            if name not in placed
        }
        return KnownError.of(errors.values(), silent)


def _sum_if_all_known(values: Iterable[float | None]) -> float | None:
    known = list(values)
    return math.fsum(v for v in known if v is not None) if None not in known else None
