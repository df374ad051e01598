"""Which robots an agent follows, and the law's input from them.

It follows the neighbours that can be followed; if there are none, fallbacks that can be; if there are none of
those either, neighbours that are returning to their slots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from formation.agent.following.neighbour import Neighbour, NeighbourState, answers
from formation.agent.following.orders import Leader
from formation.agent.following.relative_check import OwnMotion, RelativeCheck, RelativeMemory
from formation.agent.following.slots import Slots
from formation.agent.pose.estimator import Localisation
from formation.control import tracker as neighbour
from formation.control.controller import Controller, Measured
from formation.control.observer import Travel
from formation.control.trust import FULL_TRUST, GREATEST_WEIGHT, believed, mean, trust, weighted
from formation.mission.graph import cyclic_core
from formation.mission.model import Mission
from formation.protocol.reasons import Reason
from formation.stability.losses import leads
from formation.topics import RELATIVE
from formation.wire import Handler, Now

SECOND_PUBLISHER_TIME = 5.0
"""Time for which a second publisher id stays in the status [s]."""
RECOVERY_TIME = 0.5
"""Time for which a neighbour must be usable before it replaces the fallbacks [s]."""


@dataclass(slots=True, kw_only=True)
class NeighbourhoodState:
    """The neighbours, and the choice between them."""

    each: dict[str, NeighbourState]
    guides: tuple[str, ...] = ()
    """The robots that it follows now."""
    on_fallbacks: bool = False
    """Whether it follows its fallbacks."""
    usable_since: float = float("inf")
    """Since when a neighbour can be followed again [s, monotonic]."""
    own: OwnMotion = field(default_factory=OwnMotion)
    """The robot's own motion, against which displacements are checked."""
    age_limit: float = neighbour.MAX_DELAY
    """Greatest age of a displacement on arrival [s]."""


class Neighbourhood:
    """The robots that one robot may measure, and the law's input from those that it follows."""

    def __init__(self, mission: Mission, robot: str, controller: Controller) -> None:
        spec = mission.robots[robot]
        # a neighbour publishes at its own rate; a sensor measures at the rate of the robot that carries it
        local = spec.measurement == "local"
        reckons = spec.localisation == "odometry"
        offset = spec.control_point_offset
        self.each = {
            name: Neighbour(
                mission,
                name,
                spec.rate if local else mission.robots[name].rate,
                answers=not local and answers(mission, name, robot),
                check=RelativeCheck(name, offset, mission.robots[name].top_speed, by_odometry=reckons)
                if local
                else None,
            )
            for name in spec.measurable
        }
        self.state = NeighbourhoodState(each={name: one.state for name, one in self.each.items()})
        self._mission, self._robot, self._measures = mission, robot, local
        self._neighbours, self._fallbacks = spec.neighbours, spec.fallback_neighbours
        self._circular = mission.names.index(robot) in cyclic_core(mission.graph)
        self._mean = controller.mean
        self._carry = controller.delay_compensation and mission.law.delay_compensation
        self._feed_forward = controller.feed_forward and mission.law.feed_forward
        # without delay compensation a sensor's displacements are used unchanged
        self._as_measured = not controller.delay_compensation and local

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of the displacements that a sensor measures, by key."""
        measured = [one for one in self.each.values() if one.check is not None]
        return {RELATIVE.key(self._robot, one.name): one.take_displacement for one in measured}

    @property
    def guides(self) -> tuple[str, ...]:
        """The robots that it follows now."""
        return self.state.guides

    def doubt_all(self) -> None:
        """Distrust everything received so far: this process was frozen."""
        for one in self.each.values():
            one.stream.doubt()

    def moved(self, moment: float, travel: Travel | None) -> None:
        """Add an interval of own motion that ends at `moment` [s, monotonic]; None if that is unknown."""
        if self._measures:
            self.state.own.add(moment, travel)

    def judge(self, age_limit: float, now: Now) -> None:
        """Judge what sensors have measured; `age_limit` [s] as for an own position."""
        self.state.age_limit = age_limit
        for one in self.each.values():
            one.judge(self.state.own, age_limit, now)

    def doubts(self, now: Now) -> dict[str, Reason]:
        """The neighbours that are measured and not followed, because the sensor is doubted."""
        limit = self.state.age_limit
        return {
            name: doubt for name, one in self.each.items() if (doubt := one.doubt(limit, now)) is not None
        }

    def trust_all(self, moment: float) -> None:
        """End doubts about the sensor at `moment` [s, monotonic]: an operator has checked it."""
        for one in self.each.values():
            if one.check is not None:
                one.check.trust(moment)

    @property
    def memory(self) -> dict[str, RelativeMemory]:
        """What the next agent must know of what sensors have measured, by neighbour."""
        return {name: one.check.memory for name, one in self.each.items() if one.check is not None}

    def restore(self, memory: Mapping[str, RelativeMemory]) -> None:
        """Have it know what another agent did of what sensors have measured."""
        for name, one in self.each.items():
            if one.check is not None and name in memory:
                one.check.restore(memory[name])

    def choose(self, now: Now) -> None:
        """Choose which robots to follow."""
        state = self.state
        usable = self._usable(self._neighbours, now)
        if self._circular and len(usable) < len(self._neighbours):
            usable = self._leading(usable, usable)
        if usable and not state.on_fallbacks:
            state.guides = usable
            return
        others = self._leading(self._usable(self._fallbacks, now), usable)
        state.usable_since = min(state.usable_since, now.mono) if usable else float("inf")
        state.on_fallbacks = bool(others) and not now.mono - state.usable_since >= RECOVERY_TIME
        if state.on_fallbacks:
            state.guides = others
        else:
            state.guides = usable or self._leading(self._returning(now), usable)

    def _usable(self, names: tuple[str, ...], now: Now) -> tuple[str, ...]:
        return tuple(
            name for name in names if not self.each[name].state.unavailable and self._followable(name, now)
        )

    def _returning(self, now: Now) -> tuple[str, ...]:
        """Neighbours that are unavailable, and returning to their slots."""
        return tuple(
            name
            for name in self._neighbours
            if self.each[name].state.unavailable
            and self._followable(name, now)
            and self.each[name].going(now)
        )

    def _followable(self, name: str, now: Now) -> bool:
        one = self.each[name]
        return not one.state.beyond and one.fresh(now) and one.doubt(self.state.age_limit, now) is None

    def _leading(self, names: tuple[str, ...], usable: tuple[str, ...]) -> tuple[str, ...]:
        """The robots of `names` that follow the leader without this one, using only `usable` neighbours."""
        lost = set(self._neighbours).difference(usable)
        return tuple(name for name in names if leads(self._mission, name, self._robot, lost - {name}))

    def not_followed(self, now: Now) -> tuple[str, ...]:
        """The neighbours that are received and not followed."""
        return tuple(
            name for name, one in self.each.items() if name not in self.state.guides and one.fresh(now)
        )

    @property
    def beyond(self) -> tuple[str, ...]:
        """Neighbours that report to be outside the mission's bounds."""
        return tuple(name for name, one in self.each.items() if one.state.beyond)

    def leaderless(self, now: Now) -> bool:
        """Whether the leader is a neighbour, and silent."""
        leader = self._mission.leader
        return leader in self._neighbours and not self.each[leader].fresh(now)

    def silences(self, now: Now) -> dict[str, float]:
        """Silence of each [s]; infinite before the first message."""
        return {name: one.stream.silence(now) for name, one in self.each.items()}

    def contested(self, now: Now) -> list[str]:
        """The neighbours for which a second process has published recently."""
        return [
            one.name
            for one in self.each.values()
            if now.mono - one.publisher.state.contested < SECOND_PUBLISHER_TIME
        ]

    def place(self, here: Localisation) -> None:
        """Convert what sensors have measured to the world frame; call this with every odometry message."""
        for one in self.each.values():
            one.place(here)

    def measured(self, here: Localisation, slots: Slots, now: Now, leader: Leader | None = None) -> Measured:
        """Return the law's input: means or sums over the robots that it follows, at least one.

        `leader`: what its orders say of it, if that is used.
        """
        me, heading, my_age = here.point, here.heading, here.stream.age(now)
        mine, my_velocity = slots.state.at[self._robot], slots.state.velocity[self._robot]
        leader_speed = slots.state.leader_speed
        relative, desired, velocity, weights, skew = 0j, 0j, 0j, 0.0, 0j
        turn, share = heading.conjugate(), FULL_TRUST
        for name in self.state.guides:
            one = self.each[name]
            # slots move as well: what is left of a neighbour's velocity is the formation's
            carried = one.velocity - slots.state.velocity[name]
            if self._as_measured:
                seen = one.state.displacement
            else:
                seen = turn * (one.point(now, my_age, carry=self._carry) - me)
            if leader is not None:
                share = trust(carried - leader.velocity, 0.0, one.top_speed)
            elif self._mean:
                share = trust(carried, leader_speed, one.top_speed)
            relative += weighted(share.weight, turn * turn * share.skew, seen)
            desired += weighted(share.weight, share.skew, slots.state.at[name] - mine)
            velocity += share.weight * carried
            weights, skew = weights + share.weight, skew + share.skew
        if leader is not None and leader.place is not None:
            relative += GREATEST_WEIGHT * (turn * (leader.place - me))
            desired -= GREATEST_WEIGHT * mine
            weights += GREATEST_WEIGHT
        part = 1.0 / weights
        if not self._mean:
            mean_velocity = part * velocity + my_velocity if self._feed_forward else 0j
            return Measured(relative, desired, len(self.state.guides), mean_velocity)
        seen_velocity = part * velocity if leader is None else leader.velocity
        mean_velocity = believed(seen_velocity, leader_speed) + my_velocity
        relative, desired = mean(weights, turn * turn * skew, relative), mean(weights, skew, desired)
        return Measured(relative, desired, 1, mean_velocity if self._feed_forward else 0j)
