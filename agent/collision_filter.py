"""The obstacles of the collision filter, from what this robot knows, and the filter's state.

Obstacles are the robots that it may measure, those that its mission has it avoid (their positions are used
for nothing else), and everything else in its range scan. A robot that has fallen silent may stand anywhere
between its last known position and where its velocity would have carried it before its failsafe stopped it,
for as long as this agent runs. Robots of which nothing was received are not obstacles; the status names them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from formation.agent.following.neighbour import Neighbour, NeighbourState, answers
from formation.agent.following.neighbours import Neighbourhood
from formation.agent.pose.estimator import Localisation
from formation.agent.safety.scanner import MAX_EMPTY_TIME, MAX_OBSTACLE_DISTANCE, Scanner, ScannerState
from formation.control.avoidance import Avoidance, Obstacle
from formation.control.controller import Controller
from formation.control.pipeline import ControlState, Outcome
from formation.control.tracker import unknown
from formation.control.zones import Sight, Zone
from formation.mission.model import Mission
from formation.sensing import scan
from formation.sensing.scan import Circle, Mate
from formation.wire import Now

MAX_DIRECTION_DOUBT = 0.2
"""Do not remove a robot from the scan if its direction is uncertain by more than this [rad]: the points
removed could be a post's."""


@dataclass(slots=True, kw_only=True)
class AvoidingState:
    """State of the collision filter, and the obstacles."""

    others: dict[str, NeighbourState]
    scanner: ScannerState | None
    avoidance: Avoidance = field(default_factory=Avoidance)
    avoided: int = 0
    """Number of commands that were changed, or would have been."""
    acting: bool = False
    """Whether the newest command was changed."""


class Avoiding:
    """One robot's collision filter."""

    def __init__(self, mission: Mission, robot: str, controller: Controller) -> None:
        spec, avoided = mission.robots[robot], mission.avoided_by(robot)
        self.mode = mission.collisions.mode if controller.collision_filter else "off"
        self.others = {
            name: Neighbour(mission, name, mission.robots[name].rate, answers=answers(mission, name, robot))
            for name in avoided
            if name not in spec.measurable and self.mode != "off"
        }
        """The robots that it avoids and does not measure."""
        self.scanner = Scanner(mission, robot) if spec.scanner != "none" else None
        """Its range scan; the protective zones hold in every mode and law."""
        self.state = AvoidingState(
            others={name: one.state for name, one in self.others.items()},
            scanner=None if self.scanner is None else self.scanner.state,
        )
        self.avoids: tuple[str, ...] = tuple(avoided) if self.mode != "off" else ()
        """The robots that the filter knows by message or measurement."""
        self._specs = {name: mission.robots[name] for name in avoided}
        self._first = {name: mission.has_right_of_way(name, robot) for name in avoided}
        self._local = spec.measurement == "local"
        self._limits = spec.limits
        self._apart, self._delay = mission.collisions.room, mission.collisions.delay

    def obstacles(
        self, here: Localisation, around: Neighbourhood, now: Now
    ) -> tuple[list[Obstacle], list[Obstacle], Sight | None]:
        """Return the known robots, what else the scan shows (neither with mode off), and the sight."""
        known = self._known(around)
        robots = {name: self._obstacle(name, one, here, now) for name, one in known.items()}
        strangers = self._strangers(robots, known, now)
        sight = None if self.scanner is None else self.scanner.sight(strangers, now)
        return (
            ([], [], sight) if self.mode == "off" else ([*robots.values()], [*self._seen(strangers)], sight)
        )

    def beside(self, sight: Sight | None, speed: float, kept: Callable[[float], float]) -> Sight | None:
        """Return the sight of a robot that probes straight on at `speed` [m/s], maybe inside its margin."""
        return None if self.scanner is None or sight is None else self.scanner.beside(sight, speed, kept)

    def expect(self, here: Localisation, around: Neighbourhood, now: Now) -> None:
        """Tell the scanner how far away the robots are that it should show."""
        if self.scanner is None:
            return
        each, age = {}, here.stream.age(now)
        if self.scanner.empty(now) > MAX_EMPTY_TIME:
            each = {name: one for name, one in {**around.each, **self.others}.items() if one.fresh(now)}
        self.scanner.expect(
            {
                name: abs(one.around(now, age, body=True).at - here.state.position)
                for name, one in each.items()
                if one.state.body is not None
            }
        )

    def stepped(self, state: ControlState, outcome: Outcome) -> None:
        """Store the filter's state and the protective zone that the control step returned."""
        self.state.avoidance, self.state.acting = state.avoidance, outcome.filtered
        self.state.avoided += outcome.filtered
        if self.scanner is not None and outcome.zone is not None:
            self.scanner.state.zone = outcome.zone

    @property
    def blind_at(self) -> float:
        """When a required scanner counts as silent, if nothing arrives [s, monotonic]."""
        return (
            self.scanner.stream.stale_at if self.scanner is not None and self.scanner.required else math.inf
        )

    def rested(self) -> None:
        """Forget the detour: the robot does not drive."""
        state = self.state
        state.avoidance, state.acting = state.avoidance._replace(kept=0.0, detour=0.0, side=0.0), False
        if self.scanner is not None:
            self.scanner.state.zone = Zone.CLEAR

    @property
    def has_obstacles(self) -> bool:
        """Whether there is anything that the filter could avoid."""
        return bool(self.avoids) or (self.scanner is not None and self.mode != "off")

    def never_received(self, around: Neighbourhood) -> tuple[str, ...]:
        """The robots of `avoids` of which nothing has been received yet."""
        return tuple(sorted(set(self.avoids).difference(self._known(around))))

    def doubt_all(self) -> None:
        """Distrust everything received so far: this process was frozen."""
        for one in self.others.values():
            one.stream.doubt()
        if self.scanner is not None:
            self.scanner.stream.doubt()

    def _known(self, around: Neighbourhood) -> dict[str, Neighbour]:
        """The robots that were received or measured at least once."""
        all_of_them = {name: self.others.get(name) or around.each[name] for name in self.avoids}
        return {name: one for name, one in all_of_them.items() if one.stream.state.arrived is not None}

    def _strangers(
        self, obstacles: Mapping[str, Obstacle], known: Mapping[str, Neighbour], now: Now
    ) -> list[Circle]:
        """What the scan shows besides the robots that report their positions [body frame]."""
        if self.scanner is None:
            return []
        mates = [
            Mate(name, one.at, one.radius, one.velocity)
            for name, one in obstacles.items()
            if self.mode == "on" and known[name].fresh(now) and one.doubt < MAX_DIRECTION_DOUBT
        ]
        return self.scanner.strangers(now, mates)

    def _seen(self, strangers: Sequence[Circle]) -> Iterator[Obstacle]:
        # pass obstacles of the scan at the distance that the protective zones ask for
        wider = 0.0 if self.scanner is None else max(0.0, self.scanner.margin - self._apart)
        for one in scan.obstacles(strangers, MAX_OBSTACLE_DISTANCE):
            yield one._replace(radius=one.radius + wider)

    def _sensed(self, name: str) -> bool:
        """Whether a sensor on the body measures it, so that the heading in the world does not matter."""
        return self._local and name not in self.others

    def _obstacle(self, name: str, one: Neighbour, here: Localisation, now: Now) -> Obstacle:
        spec, sensed = self._specs[name], self._sensed(name)
        there = one.around(now, here.stream.age(now), body=not sensed)
        # a sensor sees the control point; the centre is within an offset of it
        mine, facing, radius = here.state.position, here.course.conjugate(), spec.radius
        if sensed:
            mine, facing = here.point, here.heading.conjugate()
            radius += spec.control_point_offset
        since = unknown(there.age, self._delay, spec.top_speed, there.last - mine, there.at - mine)
        return Obstacle(
            facing * (there.at - mine) + (self._limits.offset if sensed else 0.0),
            radius + there.unsure + since.nearer,
            facing * there.velocity,
            self._first[name],
            stands=not one.fresh(now),
            doubt=0.0 if sensed else here.course_doubt,
            age=since.age,
            unsure=since.aside,
        )
