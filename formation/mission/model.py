"""A mission: its robots, the measurement graph, the shapes, the law and the leader's route.

Frozen pydantic models, shaped like the mission file (`formation.mission.file`). An existing Mission is legal:
what the types cannot say is checked on construction, and a violation names key, value and what is legal.
"""

from __future__ import annotations

import cmath
import hashlib
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from formation.control.avoidance import NOISE_DEVIATIONS, AvoidanceParameters, margin_kept
from formation.control.controller import Controller, Gains, fastest_gain
from formation.control.laws import DEFAULT, LAWS, UNUSABLE, law_of
from formation.control.pipeline import ControlParams, protected, unprotected
from formation.control.quantiser import Quantiser
from formation.control.ramp import ramp_limits
from formation.control.unicycle import Command
from formation.mission import rules as mission_rules
from formation.mission.graph import Graph, cyclic_core
from formation.mission.robot import Post, RobotDefaults, RobotSpec, SimulatedScanner, Wall
from formation.mission.route import MIN_LEG_LENGTH, Leg, Waypoints
from formation.mission.tables import Endpoint, Name, NotNegative, Point, Positive, Table, Title, as_tuple

TAG_CHARS = 8
"""Length of a mission's tag [characters]: 32 bits, against accidents."""


def _known_law(value: Any) -> Any:
    if isinstance(value, str) and (value in LAWS or value in UNUSABLE):  # robots may be driven by it already
        return value
    *others, last = map(repr, LAWS)
    raise PydanticCustomError("law", f"Input should be {', '.join(others)} or {last}")


class LawSpec(Table):
    """The control law and the heading observer."""

    kind: Annotated[str, BeforeValidator(_known_law)] = DEFAULT
    """Name of the control law; `--law` replaces it."""
    gain: Positive | None = None
    """Gain of the law `field`: rate at which the mean error of the neighbours is closed [1/s]; by default
    as high as `collisions.lag`, the robots' rates and cycles of the graph allow, at most 12."""
    k_p: Positive = 2.0
    """Proportional gain k_P of the other laws, for the sum of the neighbours' errors [1/s]."""
    k_i: NotNegative = 1.0
    """Integral gain k_I; not used by laws without an integral [1/s²]."""
    observer_gain: Positive = 5.0
    """Gain k of the heading observer of the law `paper`, and of the collision filter's [1/m]."""
    velocity_filter: Positive = 0.04
    """Time constant of the low-pass filter of the neighbours' velocities [s]."""
    feed_forward: bool = True
    """Add the neighbours' mean velocity to the command, if the law has a feed-forward."""
    leader_orders: Literal["signed", "velocity", "place", "none"] = "signed"
    """What the law `field` uses of the leader's orders besides its neighbours: its velocity where orders are
    `signed`, its `velocity`, its velocity and `place`, or `none`."""
    delay_compensation: bool = True
    """Extrapolate neighbours' positions to the present by their velocities, if the law does so."""

    def uses_orders(self, *, signed: bool) -> bool:
        """Whether robots use the leader's velocity, by orders that are `signed` or not."""
        named = self.leader_orders in {"velocity", "place"} or (signed and self.leader_orders == "signed")
        return named and self.controller.mean

    @property
    def controller(self) -> Controller:
        """The law itself."""
        return law_of(self.kind)

    @property
    def feeds_forward(self) -> bool:
        """Whether the neighbours' velocity is fed forward: the law takes it, and the mission wants it."""
        return self.controller.feed_forward and self.feed_forward


class SimulatedRobot(Table):
    """[simulated_robot]: drive and odometry of simulated robots: a profile, and values that replace it."""

    profile: Literal["ideal", "turtlebot3_burger"] = "ideal"
    """Set of values; each of the following keys replaces one of them."""
    lag: NotNegative | None = None
    """Time constant of the wheels [s]."""
    max_speed: Positive | None = None
    """Highest speed that the firmware allows [m/s]."""
    max_turn_rate: Positive | None = None
    """Highest turn rate that the firmware allows [rad/s]."""
    speed_step: NotNegative | None = None
    """The firmware truncates speeds to multiples of this; 0 for none [m/s]."""
    turn_rate_step: NotNegative | None = None
    """The firmware truncates turn rates to multiples of this; 0 for none [rad/s]."""
    position_noise: NotNegative | None = None
    """Standard deviation of each odometry position, per axis [m]."""
    heading_noise: NotNegative | None = None
    """Standard deviation of each odometry heading [rad]."""
    drift: NotNegative | None = None
    """Odometry error as a share of the distance travelled."""


MAX_SHAPES = 100
MAX_HORIZON = 3600.0
"""Longest simulated run [s]."""


class SimulationSpec(Table):
    """[simulation]: random starts, length and step of `formation simulate`, and obstacles."""

    spread: NotNegative = 1.0
    """Random starts: control points are uniform within ± this of their slots, on each axis [m]."""
    horizon: Annotated[float, Field(gt=0.0, le=MAX_HORIZON)] = 120.0
    """Length of a simulated run [s]."""
    step: Annotated[float, Field(ge=0.001, le=0.2)] = 0.02
    """Time step of the simulation [s]."""
    posts: Annotated[tuple[Post, ...], BeforeValidator(as_tuple)] = ()
    """Round obstacles that simulated scanners see."""
    walls: Annotated[tuple[Wall, ...], BeforeValidator(as_tuple)] = ()
    """Walls that simulated scanners see."""


class Standby(Table):
    """[standbys.NAME]: a process that can take over from the leader; the first listed takes over first."""

    endpoint: Endpoint | None = None
    """Zenoh endpoint on which the standby listens; by default on this machine."""


class Collisions(Table):
    """[collisions]: the collision filter between robots."""

    mode: Literal["on", "warn", "off"] = "on"
    """`on` changes commands to avoid collisions; `warn` only reports it in the status; `off` disables it."""
    margin: NotNegative = 0.02
    """Free distance kept between two bodies; larger if `noise` requires it [m]."""
    lag: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Time constant with which robots follow commands [s]."""
    noise: Annotated[float, Field(ge=0.0, le=0.1)] = 0.002
    """Standard deviation of robots' positions, per axis; their filters expect it, too [m]."""
    delay: Annotated[float, Field(ge=0.0, le=0.5)] = 0.2
    """Age of other robots' positions that is normal; a robot seen longer ago counts as larger [s]."""

    @property
    def room(self) -> float:
        """What the filter keeps between two bodies [m]: the margin, or more where noise takes more."""
        return margin_kept(self.margin, self.noise)

    @property
    def blind(self) -> float:
        """The same while a robot does not know its heading yet: it needs room to learn it [m]."""
        return min(self.room, NOISE_DEVIATIONS * self.noise)


class Bounds(Table):
    """[bounds]: the rectangle in which robots may be; a robot outside it holds."""

    x: Point
    """Least and greatest x [m; world frame]."""
    y: Point
    """Least and greatest y [m; world frame]."""


class Cohesion(Table):
    """[cohesion]: the leader slows down, and waits, while edge errors are large."""

    error: Positive
    """Largest edge error at which the leader stands still; it slows down from half of this on [m]."""
    patience: Positive | None = None
    """Longest time that the leader waits for the same robot; without this key it waits for ever [s]."""
    robots: Annotated[tuple[Name, ...], BeforeValidator(as_tuple)] = ()
    """Followers that the leader waits for, and is linked with; by default all."""


class Mission(Table):
    """What every process needs to know; it does not change while processes run."""

    name: Title
    """Title of the mission; recordings and reports carry it."""
    leader: Name
    """Name of the leader, which is one of the robots; it has no body and follows the route."""
    team: Name | None = None
    """Zenoh namespace, which separates two fleets on one network; by default none."""
    duration: Positive = 30.0
    """How long `formation run` drives [s]."""
    settled: Positive = 0.05
    """Formation error, summed over all edges, below which the formation counts as settled [m]."""
    shape: Name | None = None
    """The shape to start with; by default the first."""
    turning: bool = False
    """Rotate shapes with the leader's heading; slots are then x ahead and y to the left of the leader."""
    takeover: Annotated[float, Field(ge=0.4, le=60.0)] = 1.0
    """Time in which a standby replaces a silent leader, approximately [s]."""
    law: LawSpec = LawSpec()
    """Control law and its parameters."""
    robot: RobotDefaults = RobotDefaults()
    """Values of all robots that do not have their own."""
    shapes: dict[Name, dict[Name, Point]] = Field(min_length=1, max_length=MAX_SHAPES)
    """Slots: [shapes.SHAPE] has x, y of each follower's control point, relative to the leader [m]."""
    robots: dict[Name, RobotSpec] = Field(min_length=2)
    """One table for each robot, the leader included."""
    route: Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """Legs of the leader's route, in order."""
    standbys: dict[Name, Standby] = Field(default={}, max_length=63)
    """Processes that can take over from the leader, in order."""
    collisions: Collisions = Collisions()
    """Collision filter."""
    cohesion: Cohesion | None = None
    """Cohesion: whether the leader waits for the followers; by default it does not."""
    bounds: Bounds | None = None
    """Where robots may be; by default a rectangle around all starts and the first hour of the route, with
    room on every side."""
    simulated_robot: SimulatedRobot = SimulatedRobot()
    """Drive and odometry of simulated robots."""
    simulated_scanner: SimulatedScanner = SimulatedScanner()
    """Range scanner of simulated robots."""
    simulation: SimulationSpec = SimulationSpec()
    """Simulated runs and obstacles."""

    @model_validator(mode="before")
    @classmethod
    def _spread_defaults(cls, data: Any) -> Any:
        """Give every robot what [robot] says, where both are tables; what is not is refused later."""
        if not isinstance(data, dict) or not isinstance(data.get("robots"), dict):
            return data
        defaults = data.get("robot", {})
        if not isinstance(defaults, dict):
            return data
        known = {key: value for key, value in defaults.items() if key in RobotDefaults.model_fields}
        robots = {
            name: {**known, **robot} if isinstance(robot, dict) else robot
            for name, robot in data["robots"].items()
        }
        return {**data, "robots": robots}

    @model_validator(mode="after")
    def _legal(self) -> Self:
        mission_rules.enforce(self)
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """All robots: the leader, then the followers as the file lists them. Index 0 is the leader."""
        return (self.leader, *self.followers)

    @cached_property
    def followers(self) -> tuple[str, ...]:
        """The followers as the file lists them."""
        return tuple(name for name in self.robots if name != self.leader)

    @cached_property
    def candidates(self) -> tuple[str, ...]:
        """Candidates by rank: the leader's own process, then the standbys in the file's order."""
        return (self.leader, *self.standbys)

    @cached_property
    def fingerprint(self) -> str:
        """A short name of all that the mission says: equal for equal missions, however their files look."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]

    @property
    def tag(self) -> str:
        """The part of the fingerprint that goes with every position and ballot."""
        return self.fingerprint[:TAG_CHARS]

    def avoided_by(self, robot: str) -> tuple[str, ...]:
        """Followers that `robot` avoids: those it may measure, and those of its `avoid`.

        The virtual leader has no body, and with collisions "off" no robot avoids another.
        """
        return self.avoidance.get(robot, ())

    @cached_property
    def avoidance(self) -> Mapping[str, tuple[str, ...]]:
        """What `avoided_by` gives for each follower."""
        if self.collisions.mode == "off":
            return {}
        found = {}
        for robot in self.followers:
            spec = self.robots[robot]
            avoided = {*spec.measurable, *(self.followers if spec.avoid == "all" else spec.avoid)} - {robot}
            found[robot] = tuple(name for name in self.followers if name in avoided)
        return found

    def received_by(self, robot: str) -> tuple[str, ...]:
        """Publishers of the positions that `robot` receives: measured robots, then others to avoid."""
        return tuple(dict.fromkeys((*self.robots[robot].measurable, *self.avoided_by(robot))))

    @property
    def waited_for(self) -> tuple[str, ...]:
        """Followers for which the leader waits."""
        if self.cohesion is None:
            return ()
        return self.cohesion.robots or self.followers

    def has_right_of_way(self, robot: str, other: str) -> bool:
        """Whether `robot` passes first: it is nearer to the leader in the graph, or else in the file."""
        first, second = self.names.index(robot), self.names.index(other)
        return (self.graph.depths[first] or 0, first) < (self.graph.depths[second] or 0, second)

    def landmarks_of(self, robot: str) -> tuple[str, ...]:
        """Neighbours by which a robot with `measurement = "scan"` corrects its pose: those that pass first.

        Errors thus go only one way. The virtual leader has no body.
        """
        spec = self.robots[robot]
        if spec.measurement != "scan":
            return ()
        bodies = [name for name in spec.measurable if name != self.leader]
        return tuple(name for name in bodies if self.has_right_of_way(name, robot))

    def under(self, law: str) -> Mission:
        """The same mission under another law."""
        return self.changed(law=self.law.model_copy(update={"kind": law}))

    def changed(self, **values: Any) -> Mission:
        """The same mission with other values of some keys, which are not checked."""
        same = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self).model_construct(**{**same, **values})

    @cached_property
    def gains(self) -> Gains:
        """The gains of the mission's law."""
        return self.gains_for(self.law.controller)

    def gains_for(self, controller: Controller) -> Gains:
        """The gains as another law takes them."""
        if not controller.mean:
            return Gains(self.law.k_p, self.law.k_i if controller.integral else 0.0)
        slowest = min(self.robots[name].rate for name in self.followers)
        cycle = len(cyclic_core(self.graph))
        derived = fastest_gain(self.collisions.lag, 1.0 / slowest, cycle, self.law.velocity_filter)
        return Gains(self.law.gain or derived, self.law.k_i if controller.integral else 0.0)

    @property
    def leader_speed(self) -> float:
        """Top speed of the leader on its route [m/s]."""
        return max(leg.speed for leg in self.route)

    def control(self, robot: str, controller: Controller, step: float = 0.0) -> ControlParams:
        """The control pipeline's parameters for a robot.

        `step`: a simulation's time between commands [s], where it is longer than the robot's own period.
        """
        spec, rules = self.robots[robot], self.collisions
        hold = max(spec.longest_command, step)
        rate = min(spec.rate, 1.0 / step) if step > 0.0 else spec.rate
        return ControlParams(
            controller.step,
            spec.limits if controller.ramp else spec.limits._replace(acceleration=math.inf),
            AvoidanceParameters(spec.radius, rules.room, hold, rules.blind, rules.lag),
            rules.mode == "on" and controller.collision_filter,
            ramp_limits(spec.ramp if controller.ramp else 0.0, rate),
            unprotected if spec.scanner == "none" else protected,
            Quantiser.of(Command(spec.speed_step, spec.turn_rate_step), spec.limits),
        )

    @property
    def first_shape(self) -> str:
        """Name of the shape to start with."""
        return self.shape or next(iter(self.shapes))

    @cached_property
    def graph(self) -> Graph:
        """The measurement graph over `names`."""
        index = {name: i for i, name in enumerate(self.names)}
        return Graph(tuple(tuple(index[j] for j in self.robots[name].neighbours) for name in self.names))

    def slot(self, robot: str, shape: str | None = None) -> complex:
        """Control point of `robot` in the shape, relative to the leader's [m; world frame]."""
        if robot == self.leader:
            return 0j
        return complex(*self.shapes[shape or self.first_shape][robot])

    def slots(self, shape: str | None = None) -> tuple[complex, ...]:
        """The shape over `names`, the leader's slot (0) first [m; world frame]."""
        return tuple(self.slot(name, shape) for name in self.names)

    @cached_property
    def leader_heading(self) -> complex:
        """The leader's first direction: what followers first believe their heading to be."""
        first = self.route[0]
        if isinstance(first, Waypoints):
            leg = complex(*first.waypoints[0]) - self.robots[self.leader].start.position
            return leg / abs(leg) if abs(leg) > MIN_LEG_LENGTH else self.robots[self.leader].start.heading
        if first.heading_deg is None:
            return self.robots[self.leader].start.heading
        return cmath.rect(1.0, math.radians(first.heading_deg))

    def first_heading(self, robot: str) -> complex:
        """First guess of a follower's heading observer [world frame]."""
        configured = self.robots[robot].first_heading_deg
        return self.leader_heading if configured is None else cmath.rect(1.0, math.radians(configured))
