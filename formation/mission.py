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

from pydantic import BeforeValidator, Field, model_validator

from formation import mission_rules
from formation.avoidance import DEVIATIONS, margin_kept
from formation.endpoint import Endpoint
from formation.graph import Graph
from formation.law import Gains
from formation.legs import Leg, Waypoints
from formation.robot_spec import RobotDefaults, RobotSpec
from formation.scan_spec import Post, SimulatedScanner, Wall
from formation.tables import Name, NotNegative, Point, Positive, Table, Title, as_tuple

TAG = 8
"""Length of a mission's tag [characters]: 32 bits, against accidents."""


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


MAX_SHAPES = 100
MAX_HORIZON = 3600.0
"""Longest simulated run [s]."""


class SimulationSpec(Table):
    """[simulation]: how `formation simulate` draws and judges many starts."""

    spread: NotNegative = 1.0
    """Control points start uniformly within ± this of their slots, on each axis [m]."""
    horizon: Annotated[float, Field(gt=0.0, le=MAX_HORIZON)] = 120.0
    """[s]"""
    step: Annotated[float, Field(ge=0.001, le=0.2)] = 0.02
    """[s]"""
    posts: Annotated[tuple[Post, ...], BeforeValidator(as_tuple)] = ()
    """What stands in the simulated world, for scanners to see."""
    walls: Annotated[tuple[Wall, ...], BeforeValidator(as_tuple)] = ()


class Standby(Table):
    """[standbys.NAME]: a process that takes the leader's place when it is gone; first listed, first to."""

    endpoint: Endpoint | None = None
    """Where it listens."""


class Collisions(Table):
    """[collisions]: how robots keep clear of each other."""

    mode: Literal["on", "warn", "off"] = "on"
    """`warn` only says in the status what would be done."""
    margin: NotNegative = 0.02
    """Room that is left between two bodies [m]."""
    lag: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Time constant with which robots follow commands [s]."""
    noise: Annotated[float, Field(ge=0.0, le=0.1)] = 0.002
    """Standard deviation of robots' positions, per axis [m]."""
    delay: Annotated[float, Field(ge=0.0, le=0.5)] = 0.2
    """Positions of others may be so late [s]."""

    @property
    def room(self) -> float:
        """What the filter keeps between two bodies [m]: the margin, or more where noise takes more."""
        return margin_kept(self.margin, self.noise)

    @property
    def blind(self) -> float:
        """The same while a robot does not know its heading yet: it needs room to learn it [m]."""
        return min(self.room, DEVIATIONS * self.noise)


class Bounds(Table):
    """[bounds]: where robots may be, a rectangle of the world frame; a robot outside it holds."""

    x: Point
    """From, to [m]."""
    y: Point
    """From, to [m]."""


class Together(Table):
    """[together]: the leader slows, and waits, while the formation is torn."""

    error: Positive
    """Longest edge error at which it stands; from half of that on it slows [m]."""
    patience: Positive | None = None
    """It waits at most so long for the same robots, then goes on without them [s]; by default for ever."""


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
    turning: bool = False
    """Whether shapes turn with the leader; slots are then relative to its heading, x ahead, y to the left."""
    takeover: Annotated[float, Field(ge=0.4, le=60.0)] = 1.0
    """Within about so long a standby takes the place of a leader that has fallen silent [s]."""
    law: LawSpec = LawSpec()
    robot: RobotDefaults = RobotDefaults()
    shapes: dict[Name, dict[Name, Point]] = Field(min_length=1, max_length=MAX_SHAPES)
    robots: dict[Name, RobotSpec] = Field(min_length=2)
    route: Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    standbys: dict[Name, Standby] = Field(default={}, max_length=63)
    collisions: Collisions = Collisions()
    together: Together | None = None
    bounds: Bounds | None = None
    """Where robots may be; by default see `formation.geofence`."""
    simulated_robot: SimulatedRobot = SimulatedRobot()
    simulated_scanner: SimulatedScanner = SimulatedScanner()
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
    def candidates(self) -> tuple[str, ...]:
        """Who may lead, by rank: the leader's own process, then the standbys as the file lists them."""
        return (self.leader, *self.standbys)

    @cached_property
    def fingerprint(self) -> str:
        """A short name of all that the mission says: equal for equal missions, however their files look."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]

    @property
    def tag(self) -> str:
        """The part of the fingerprint that goes with every position and ballot."""
        return self.fingerprint[:TAG]

    def minded(self, robot: str) -> tuple[str, ...]:
        """Followers out of whose way `robot` gets: whom it may measure, and whom it is to mind.

        The virtual leader has no body, and with collisions "off" nobody minds anybody.
        """
        if robot == self.leader or self.collisions.mode == "off":
            return ()
        spec = self.robots[robot]
        more = self.followers if spec.mind == "all" else spec.mind
        return tuple(
            name for name in self.followers if name != robot and (name in spec.measurable or name in more)
        )

    def heard(self, robot: str) -> tuple[str, ...]:
        """Whose positions `robot` is to hear: whom it may measure, then whom else it minds."""
        return tuple(dict.fromkeys((*self.robots[robot].measurable, *self.minded(robot))))

    def has_right_of_way(self, robot: str, other: str) -> bool:
        """Whether `robot` passes first: it is nearer to the leader in the graph, or else in the file."""
        first, second = self.names.index(robot), self.names.index(other)
        return (self.graph.depths[first] or 0, first) < (self.graph.depths[second] or 0, second)

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
            way = complex(*first.waypoints[0]) - self.robots[self.leader].start.position
            return way / abs(way) if abs(way) > 0.0 else self.robots[self.leader].start.heading
        if first.heading_deg is None:
            return self.robots[self.leader].start.heading
        return cmath.rect(1.0, math.radians(first.heading_deg))

    def first_heading(self, robot: str) -> complex:
        """First guess of a follower's heading observer [world frame]."""
        configured = self.robots[robot].first_heading_deg
        return self.leader_heading if configured is None else cmath.rect(1.0, math.radians(configured))
