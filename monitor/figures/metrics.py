"""How well the formation stands, from what the fleet says: bytes in, figures out, without a clock.

Robots are sampled at different times, so all are brought to one moment before they are compared: the newest
that every robot still heard has reached. A robot that has fallen silent makes what depends on it unknown;
what is known of the others is summed apart, with the number of edges that it is over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from itertools import chain

from formation import order
from formation.mission import Mission
from formation.order import Order, Told
from formation.topics import POSITION
from formation.wire import BadMessage, Now, Sample
from monitor.figures.asked import Requests
from monitor.figures.candidates import Candidates
from monitor.figures.feed import freshness_limit
from monitor.figures.heard import Heard, Tracked
from monitor.figures.keys import Watched, watched
from monitor.figures.known import KnownError, KnownSettling
from monitor.figures.orders import Lead, Orders, Wish
from monitor.figures.rejections import Rejections
from monitor.figures.settling import Settling
from monitor.figures.snapshot import Edge, Snapshot
from monitor.figures.trajectory import Placed

Errors = Mapping[Edge, float | None]
SET = 1.0
"""By more our system clock goes ahead or back only if somebody sets it [s]; what is less passes by itself."""


WAITS = "waits for "
"""So the reason begins that whoever leads gives in its status while it waits."""


class Metrics:
    """Figures of one mission's fleet."""

    def __init__(self, mission: Mission) -> None:
        self.rejections = Rejections()
        self._mission = mission
        self._edges = tuple(
            Edge(name, other) for name in mission.names for other in mission.robots[name].neighbours
        )
        self._requests = Requests()
        slowest = max(freshness_limit(robot.rate) for robot in mission.robots.values())
        keys: dict[str, list[Watched]] = {}
        for one in watched(mission):
            keys.setdefault(one.robot, []).append(one)
        self._robots = {
            name: Heard(mission, name, keys[name], slowest, self._requests) for name in mission.names
        }
        self._leader = self._robots[mission.leader]
        self._candidates = Candidates(mission, keys, self._leader.statuses, self._requests)
        self._routes = {
            key: (feed, handle)
            for key, feed, handle in chain(
                *(robot.routes() for robot in self._robots.values()), self._candidates.routes()
            )
        }
        self._orders = Orders(mission, self._leader.place.trajectory.size)
        self._positions = {POSITION.key(name): self._robots[name] for name in mission.names}
        self._ahead = math.inf  # our system clock before the monotonic one [s]
        self._settling = Settling(mission.settled, slowest)
        self._known = KnownSettling(mission.settled, slowest)

    def take(self, sample: Sample, wall: float) -> None:
        """Learn from one message that arrived at `wall` [s, our system clock]; a bad one is counted."""
        feed, handle = self._routes.get(sample.key, (None, None))
        if feed is None:
            self.rejections.count("elsewhere", "unknown key")
            return
        ahead = wall - sample.arrived
        if abs(ahead - self._ahead) > SET:
            self._clock_was_set()
        self._ahead = ahead
        feed.heard(sample.arrived)
        try:
            if sample.key in self._positions:
                self._place(self._positions[sample.key], sample, wall)
            elif handle is not None:
                handle(sample, wall)
        except BadMessage as bad:
            self.rejections.count(sample.key, str(bad))
            feed.rejected = sample.arrived
            return
        feed.accepted = sample.arrived

    def observe(self, now: Now) -> float | None:
        """Bring all robots to one moment and compare them: the formation error [m], None if not known.

        Call it steadily: settling is judged by what it sees, and by nothing else.
        """
        moment, errors = self._compare(now, lambda robot: robot.place)
        error, formed = _sum(errors.values()), moment >= self._orders.formed_since
        at = moment + now.mono - now.wall  # settling runs on the monotonic clock
        if error is not None and at > (-math.inf if self._settling.last is None else self._settling.last):
            self._settling.observe(at, error, formed=formed)
        self._known.observe(at, self._sum_known(errors, now), formed=formed)
        return error

    def observe_known(self, now: Now) -> None:
        """Judge the known edges only: while one is unknown, `observe` has nothing to judge all of them by."""
        moment, errors = self._compare(now, lambda robot: robot.place)
        formed = moment >= self._orders.formed_since
        self._known.observe(moment + now.mono - now.wall, self._sum_known(errors, now), formed=formed)

    def snapshot(self, now: Now) -> Snapshot:
        """Everything there is to know now. To look changes nothing."""
        errors = self._compare(now, lambda robot: robot.place)[1]
        start, until = self._settling.start, self._heard_until()
        lead = self._orders.lead
        leads = lead.name if lead and self._leader.place.fresh(now.mono) else None
        says = self._candidates.state(leads, now) if leads else None
        own: dict[str, list[float | None]] = {}
        for edge, value in errors.items():
            own.setdefault(edge.robot, []).append(value)
        return Snapshot(
            elapsed=0.0 if start is None else now.mono - start,
            formation_error=_sum(errors.values()),
            known=self._sum_known(errors, now),
            known_verdict=self._known.verdict(until, start),
            formation_error_true=_sum(self._compare(now, lambda robot: robot.truth)[1].values()),
            settled_at=self._settling.settled_at(until),
            converged=self._settling.converged(until),
            final_error=self._settling.final(until),
            mode=self.order.mode if self.order else None,
            shape=self.order.shape if self.order else self._mission.first_shape,
            robots={
                name: robot.figures(
                    now, KnownError.of(own.get(name, ())), says if robot is self._leader else None
                )
                for name, robot in self._robots.items()
            },
            edges=errors,
            missed=sum(robot.missed() for robot in self._robots.values()),
            rejected=self.rejections.by_reason,
            contested=frozenset(name for robot in self._robots.values() for name in robot.contests(now)),
            forgers=frozenset(name for robot in self._robots.values() for name in robot.forgers(now)),
            wish=Wish.of(self.order) if self.order else None,
            wished_at=self._settling.wished_at,
            figure=self._orders.figure,
            formed=self._orders.formed,
            tuned=self.order.tuned if self.order else None,
            lead=lead,
            leads=leads,
            waits=self._waits(leads, now),
            asked=tuple(self._requests.newest),
            candidates=self._candidates.figures(now, leads),
        )

    def placed(self, now: Now, *, truly: bool = False) -> tuple[float, Mapping[str, Placed]]:
        """The moment of comparison [s, our system clock], and where robots were at it, where that is known.

        As the robots say themselves, or `truly`: as the simulated ones know. To look changes nothing.
        """
        return self._placed(now, lambda robot: robot.truth if truly else robot.place)

    def slots(self, moment: float) -> Mapping[str, complex]:
        """Where everybody belongs at `moment` [s, our system clock], from the leader [m; world frame]."""
        return self._orders.slots(moment)

    @property
    def order(self) -> Order | None:
        """The newest order of whoever leads."""
        return self._orders.newest

    @property
    def lead(self) -> Lead | None:
        """Who led last."""
        return self._orders.lead

    def _place(self, robot: Heard, sample: Sample, wall: float) -> None:
        """Take a position, and what rides on it. Raises BadMessage."""
        if robot is not self._leader:
            robot.place_it(sample, wall)
            if sample.attachment is not None:
                robot.riding.take(sample.attachment)
            return
        said = order.decode(Told, sample.attachment).order if sample.attachment is not None else None
        if said is not None and self._orders.admit(said, sample.arrived, wall):
            robot.clock_was_set()  # another process speaks, perhaps of another machine
        robot.place_it(sample, wall)
        moment = robot.place.trajectory.latest
        if said is not None and self._orders.take(said, moment, sample.arrived, wall):
            self._settling.restart(moment - self._ahead)
            self._known.restart(moment - self._ahead)

    def _clock_was_set(self) -> None:
        self._orders.forget()
        self._candidates.clock_was_set()
        for robot in self._robots.values():
            robot.clock_was_set()

    def _waits(self, leads: str | None, now: Now) -> str:
        """For whom who leads waits, as its status says."""
        if leads is None:
            return ""
        own = leads == self._mission.leader
        state = self._leader.statuses.state(now) if own else self._candidates.state(leads, now)
        reason = state[1] if state else ""
        return reason.removeprefix(WAITS) if reason.startswith(WAITS) else ""

    def _compare(self, now: Now, which: Callable[[Heard], Tracked]) -> tuple[float, Errors]:
        """The moment of comparison [s, our system clock], and |z_ij - z*_ij| of each edge at it [m]."""
        moment, placed = self._placed(now, which)
        slots = self._orders.slots(moment)

        def error(edge: Edge) -> float | None:
            here, there = placed.get(edge.robot), placed.get(edge.neighbour)
            if here is None or there is None:
                return None
            return abs(there.point - here.point - (slots[edge.neighbour] - slots[edge.robot]))

        return moment, {edge: error(edge) for edge in self._edges}

    def _sum_known(self, errors: Errors, now: Now) -> KnownError:
        """What is known of the robots' own positions, and who is silent."""
        placed = self._placed(now, lambda robot: robot.place)[1]
        silent = {
            name: None if (age := robot.place.feed.silence(now.mono)) == math.inf else age
            for name, robot in self._robots.items()
            if name not in placed
        }
        return KnownError.of(errors.values(), silent)

    def _placed(self, now: Now, which: Callable[[Heard], Tracked]) -> tuple[float, dict[str, Placed]]:
        tracked = {name: which(robot) for name, robot in self._robots.items()}
        fresh = [name for name, one in tracked.items() if one.fresh(now.mono)]
        moment = min((tracked[name].trajectory.latest for name in fresh), default=-math.inf)
        places = {name: tracked[name].trajectory.at(moment) for name in fresh}
        return moment, {name: place for name, place in places.items() if place is not None}

    def _heard_until(self) -> float:
        """When a position last arrived from anybody [s, monotonic]."""
        return max(robot.place.feed.accepted for robot in self._robots.values())


def _sum(values: Iterable[float | None]) -> float | None:
    known = list(values)
    return math.fsum(v for v in known if v is not None) if None not in known else None
