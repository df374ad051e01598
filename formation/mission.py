"""A mission: who is in the formation, who measures whom, the shape, the law and the leader's route.

Frozen pydantic models, shaped like the mission file (see `mission_file`). A Mission that exists is legal:
what the types cannot say is checked on construction, and a violation names key, value and what is legal.
"""

from __future__ import annotations

import cmath
import hashlib
import math
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    StringConstraints,
    Tag,
    model_validator,
)

from formation import mission_rules
from formation.endpoint import Endpoint
from formation.graph import Graph
from formation.law import Gains, Limits
from formation.plane import ComplexArray

NAME, TITLE = r"^[a-z][a-z0-9_]*$", r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
Name = Annotated[str, StringConstraints(pattern=NAME, max_length=64)]
Title = Annotated[str, StringConstraints(pattern=TITLE, max_length=64)]
Positive = Annotated[float, Field(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e9)]
Speed = Annotated[float, Field(gt=0.0, le=1e3)]
"""[m/s] or [rad/s], as far as a message may carry it."""
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]

Namespace = Annotated[str, StringConstraints(max_length=128)]
"""ROS namespace without its leading slash; which spellings are legal is one of the rules."""
Ros = Literal["ros2dds", "rmw_zenoh"]
"""How ROS 2 reaches Zenoh: through zenoh-bridge-ros2dds, or natively by rmw_zenoh."""


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Point = Annotated[tuple[Metres, Metres], BeforeValidator(_tuple)]
"""x, y [m]."""


class Table(BaseModel):
    """A table of the mission file: frozen, unknown keys refused, nothing coerced, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Start(Table):
    """Where a robot's centre starts [world frame]."""

    x: Metres
    y: Metres
    heading_deg: float = 0.0

    @property
    def position(self) -> complex:
        """Centre [m; world frame]."""
        return complex(self.x, self.y)

    @property
    def heading(self) -> complex:
        """Unit complex heading [world frame]."""
        return cmath.rect(1.0, math.radians(self.heading_deg))


class LawSpec(Table):
    """The control law and the heading observer."""

    kind: Literal["field", "paper"] = "field"
    k_p: Positive = 2.0
    k_i: NotNegative = 1.0
    observer_gain: Positive = 5.0
    """k of the heading observer [1/m]."""
    anti_windup: NotNegative = 1.0
    integral_band: Positive = 0.03
    """[m]"""
    integral_decay: NotNegative = 1.0
    """[1/s]"""
    velocity_filter: Positive = 0.1
    """Time constant of the neighbours' velocity estimate [s]."""
    feed_forward: bool = True
    delay_compensation: bool = True

    @property
    def gains(self) -> Gains:
        """The parameters as `formation.law` takes them."""
        return Gains(self.k_p, self.k_i, self.anti_windup, self.integral_band, self.integral_decay)


class RobotDefaults(Table):
    """[robot]: what every robot has unless its own table says otherwise."""

    control_point_offset: Positive = 0.1
    """L [m]."""
    max_speed: Speed = 1.0
    """u_max [m/s]."""
    max_turn_rate: Speed = 1.5
    """ω_max [rad/s]."""
    radius: Positive = 0.1
    """Of a circle around the centre that holds the body [m]."""
    rate: Annotated[float, Field(ge=1.0, le=200.0)] = 20.0
    """Positions of its own, by odometry or from outside, and therefore control, per second [Hz]."""
    cmd_vel: Literal["twist", "twist_stamped"] = "twist"
    measurement: Literal["network", "local"] = "network"
    """Neighbours' positions over the network, or displacements from a sensor on the robot."""
    robot_endpoint: Endpoint | None = None
    """Where the robot itself listens: its ROS 2 bridge or router, or the simulated robot."""
    ros: Ros = "ros2dds"
    domain: Annotated[int, Field(ge=0, le=232)] = 0
    """ROS domain id; rmw_zenoh writes it into every key, a bridge has it in its own configuration."""
    namespace: Namespace | None = None
    """ROS namespace of the robot's topics; by default the robot's name, "" for none."""
    localisation: Literal["odometry", "external"] = "odometry"
    """Where the robot's position comes from: its odometry, or a camera or motion capture above the field."""
    heading: Literal["observer", "measured"] = "observer"
    """Heading estimated from positions, or taken from where the position comes from."""
    odometry_frame: Literal["world", "start"] = "world"
    """Whether odometry counts in the world frame, or from where the robot was switched on: the start pose."""
    speed_step: NotNegative = 0.0
    """The robot cuts commands to multiples of this, which error feedback makes up for [m/s]; 0 for none."""
    turn_rate_step: NotNegative = 0.0
    """[rad/s]"""


class RobotSpec(RobotDefaults):
    """[robots.NAME]: one robot."""

    neighbours: Annotated[tuple[Name, ...], BeforeValidator(_tuple)] = ()
    start: Start
    first_heading_deg: float | None = None
    """First guess of the heading observer; by default the leader's first heading."""
    endpoint: Endpoint | None = None
    """Where this robot's agent (or the leader) listens."""

    @property
    def limits(self) -> Limits:
        """The limits as `formation.law` takes them."""
        return Limits(self.control_point_offset, self.max_speed, self.max_turn_rate)

    @property
    def top_speed(self) -> float:
        """Fastest the control point can move [m/s]."""
        return math.hypot(self.max_speed, self.control_point_offset * self.max_turn_rate)


class Straight(Table):
    """A leg of constant velocity; without a duration it goes on for ever."""

    speed: NotNegative
    heading_deg: float
    duration: Positive | None = None


class Circle(Table):
    """A leg along a circle that starts in the direction of travel and turns left or right."""

    radius: Annotated[float, Field(ge=0.001, le=1e6)]
    speed: Positive
    heading_deg: float | None = None
    """Direction at the start; by default as the leg before ended, else 0."""
    turn: Literal["left", "right"] = "left"
    duration: Positive | None = None


class Waypoints(Table):
    """Legs of constant speed through points of the world frame, the first from wherever the leader is."""

    waypoints: Annotated[tuple[Point, ...], BeforeValidator(_tuple), Field(min_length=1)]
    speed: Positive


def _kind_of_leg(leg: Any) -> str:
    keys = leg if isinstance(leg, dict) else vars(leg)
    return "waypoints" if "waypoints" in keys else "circle" if "radius" in keys else "straight"


Leg = Annotated[
    Annotated[Straight, Tag("straight")]
    | Annotated[Circle, Tag("circle")]
    | Annotated[Waypoints, Tag("waypoints")],
    Discriminator(_kind_of_leg),
]


class SimulatedRobot(Table):
    """[simulated_robot]: the body that stands in for hardware; a profile, and departures from it."""

    profile: Literal["ideal", "turtlebot3_burger"] = "ideal"
    lag: NotNegative | None = None
    """Time constant of the wheels [s]."""
    max_speed: Positive | None = None
    """Clamp of the firmware [m/s]."""
    max_turn_rate: Positive | None = None
    """Clamp of the firmware [rad/s]."""
    speed_step: NotNegative | None = None
    """Commands are cut to multiples of this [m/s]; 0 for none."""
    turn_rate_step: NotNegative | None = None
    """[rad/s]"""
    position_noise: NotNegative | None = None
    """Standard deviation of each odometry sample [m]."""
    heading_noise: NotNegative | None = None
    """[rad]"""
    drift: NotNegative | None = None
    """Odometry error that grows with the path, as a share of it."""


class SimulationSpec(Table):
    """[simulation]: how `formation simulate` draws and judges many starts."""

    spread: NotNegative = 1.0
    """Control points start uniformly within ± this of their slots, on each axis [m]."""
    horizon: Positive = 120.0
    """[s]"""
    step: Annotated[float, Field(gt=0.0, le=0.2)] = 0.02
    """[s]"""


class Mission(Table):
    """Everything every process needs to know, and nothing that changes while it runs."""

    name: Title
    leader: Name
    team: Name | None = None
    """Zenoh namespace, which keeps two fleets on one network apart."""
    duration: Positive = 30.0
    """How long `formation run` drives [s]."""
    settled: Positive = 0.05
    """Formation error under which the formation counts as settled, summed over edges [m]."""
    shape: Name | None = None
    """The shape to start with; by default the first."""
    law: LawSpec = LawSpec()
    robot: RobotDefaults = RobotDefaults()
    shapes: dict[Name, dict[Name, Point]] = Field(min_length=1)
    robots: dict[Name, RobotSpec] = Field(min_length=2)
    route: Annotated[tuple[Leg, ...], BeforeValidator(_tuple), Field(min_length=1)]
    simulated_robot: SimulatedRobot = SimulatedRobot()
    simulation: SimulationSpec = SimulationSpec()

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
    def fingerprint(self) -> str:
        """A short name of all that the mission says: equal for equal missions, however their files look."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]

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

    def slots(self, shape: str | None = None) -> ComplexArray:
        """The shape over `names`, the leader's slot (0) first [m; world frame]; shape (n,)."""
        return np.array([self.slot(name, shape) for name in self.names], dtype=np.complex128)

    @cached_property
    def leader_heading(self) -> complex:
        """The leader's first direction: what followers first believe their heading to be."""
        first = self.route[0]
        if isinstance(first, Waypoints):
            way = complex(*first.waypoints[0]) - self.robots[self.leader].start.position
            return way / abs(way) if abs(way) > 0.0 else self.robots[self.leader].start.heading
        if first.heading_deg is None:
            return self.robots[self.leader].start.heading
        return cmath.rect(1.0, math.radians(first.heading_deg))

    def first_heading(self, robot: str) -> complex:
        """First guess of a follower's heading observer [world frame]."""
        configured = self.robots[robot].first_heading_deg
        return self.leader_heading if configured is None else cmath.rect(1.0, math.radians(configured))
