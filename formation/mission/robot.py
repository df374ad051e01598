"""[robot] and [robots.NAME] of a mission file: one robot, its scanner, and what all have in common.

Also range scanners and obstacles of the simulated world.
"""

from __future__ import annotations

import cmath
import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from formation.control.controller import Limits
from formation.control.tracker import FRESH_PERIODS
from formation.mission.tables import (
    Endpoint,
    Metres,
    Name,
    Namespace,
    NotNegative,
    Point,
    Positive,
    Speed,
    Table,
    as_tuple,
)
from formation.ros2.ros_names import Ros
from formation.sensing.models import LDS_01, MODELS, BeamNoise, ModelName, ScannerModel
from formation.sensing.raycast import Scanner
from formation.sensing.scan import Mount


class ScanSpec(Table):
    """[robot.scan]: the scanner, where it is mounted, and parameters of the protective zone."""

    model: ModelName | None = None
    """Model of the scanner; `rate`, `sweep`, the limits and the noise of ranges, and the simulated scanner
    follow from it. Without it: limits and sweep as each scan states, noise and simulation as of an LDS-01."""
    rate: Annotated[float, Field(ge=0.5, le=100.0)] = 5.0
    """Scans per second; by default the model's, 5 without one [Hz]."""
    x: Metres = 0.0
    """Position of the scanner, ahead of the robot's centre [m]."""
    y: Metres = 0.0
    """Position of the scanner, to the left of the robot's centre [m]."""
    yaw_deg: float = 0.0
    """Angle of the scanner's x axis from the robot's, counter-clockwise [°]."""
    sweep: Annotated[float, Field(ge=-1.0, le=1.0)] | None = None
    """Time from a scan's first beam to its last; by default the model's, or as each scan states [s].

    Negative if the first beam is the newest. Older drivers of the LDS-01 state 0.01 s; correct is -0.2 s.
    """
    margin: NotNegative | None = None
    """Free distance that the robot keeps around its radius; by default 0.05, more if its model needs more
    [m]."""
    lag: NotNegative = 0.1
    """Time constant with which the robot follows commands; its stopping distance follows from it [s]."""

    @model_validator(mode="before")
    @classmethod
    def _of_model(cls, data: Any) -> Any:
        """Give keys that are missing the values of the model; an unknown model is refused later."""
        name = data.get("model") if isinstance(data, dict) else None
        model = MODELS.get(name) if isinstance(name, str) else None
        if model is None:
            return data
        return {"rate": model.rate, "sweep": model.sweep, **data}

    @property
    def scanner(self) -> ScannerModel | None:
        """The scanner's model, if the mission names it."""
        return None if self.model is None else MODELS[self.model]

    @property
    def noise(self) -> BeamNoise:
        """Noise of beams that the robot expects."""
        return (self.scanner or LDS_01).noise

    def signed_sweep(self, stated: float) -> float:
        """Time from a scan's first beam to its last; negative if the first beam is the newest [s].

        `stated` is what the scan says of it [s].
        """
        if self.sweep is not None:
            return self.sweep
        return -stated if self.scanner is not None and self.scanner.newest_first else stated

    @property
    def mount(self) -> Mount:
        """The scanner's place on its robot."""
        return Mount(complex(self.x, self.y), cmath.rect(1.0, math.radians(self.yaw_deg)))


class SeenSpec(Table):
    """[robot.seen]: the upright cylinder that other robots' scanners see of this robot."""

    radius: Positive | None = None
    """Radius of the cylinder at the height of the scanners; by default the robot's `radius` [m]."""
    x: Metres = 0.0
    """Position of its axis, ahead of the robot's centre [m]."""
    y: Metres = 0.0
    """Position of its axis, to the left of the robot's centre [m]."""

    @property
    def at(self) -> complex:
        """Position of its axis [m; body frame]."""
        return complex(self.x, self.y)


class Start(Table):
    """Start pose of a robot's centre."""

    x: Metres
    """x of the robot's centre [m; world frame]."""
    y: Metres
    """y of the robot's centre [m; world frame]."""
    heading_deg: float = 0.0
    """Heading, counter-clockwise from x [°; world frame]."""

    @property
    def position(self) -> complex:
        """Centre [m; world frame]."""
        return complex(self.x, self.y)

    @property
    def heading(self) -> complex:
        """Unit complex heading [world frame]."""
        return cmath.rect(1.0, math.radians(self.heading_deg))


def _avoided(value: Any) -> Any:
    """A list as TOML has it, as a tuple; what is neither that nor "all" is refused in one sentence."""
    value = as_tuple(value)
    if value == "all" or (isinstance(value, tuple) and all(isinstance(one, str) for one in value)):
        return value
    raise PydanticCustomError("avoided", 'Input should be "all" or a list of robots')


MIN_MARGIN = 0.05
"""Free distance around a robot's radius by default, at least [m]."""


class RobotDefaults(Table):
    """[robot]: values of all robots; a key in [robots.NAME] replaces the one here."""

    control_point_offset: Positive = 0.1
    """Distance L of the control point ahead of the robot's centre [m]."""
    max_speed: Speed = 1.0
    """Speed limit u_max [m/s]."""
    max_turn_rate: Speed = 1.5
    """Turn rate limit ω_max [rad/s]."""
    radius: Positive = 0.1
    """Radius of a circle around the centre that contains the body [m]."""
    rate: Annotated[float, Field(ge=1.0, le=200.0)] = 20.0
    """Rate of the robot's own position (odometry or external pose), and so of its commands [Hz]."""
    cmd_vel: Literal["twist", "twist_stamped"] = "twist"
    """Message type of the robot's commands: geometry_msgs/Twist or geometry_msgs/TwistStamped."""
    measurement: Literal["network", "local", "scan"] = "network"
    """How neighbours are measured: `network` by the positions that they publish, `local` by displacements
    from a sensor on the robot, `scan` by the positions that they publish and the robot's own range scans."""
    robot_endpoint: Endpoint | None = None
    """Zenoh endpoint of the robot's ROS 2 bridge or router; by default that of the simulated robot."""
    ros: Ros = "ros2dds"
    """How ROS 2 reaches Zenoh: through zenoh-bridge-ros2dds, or natively by rmw_zenoh."""
    domain: Annotated[int, Field(ge=0, le=232)] = 0
    """ROS domain id, used with rmw_zenoh; a bridge has its own configuration."""
    namespace: Namespace | None = None
    """ROS namespace of the robot's topics; by default the robot's name, `""` for none."""
    localisation: Literal["odometry", "external"] = "odometry"
    """Source of the robot's position: its odometry, or an external pose (camera, motion capture)."""
    heading: Literal["observer", "measured"] = "observer"
    """`observer` estimates the heading from positions; `measured` takes it from the position's source."""
    odometry_frame: Literal["world", "start", "map"] = "world"
    """Frame of the odometry: the world frame, relative to the pose in `start`, or placed in a `map` by a
    localiser such as AMCL."""
    ramp: Annotated[float, Field(ge=0.0, le=10.0)] = 0.25
    """Shortest time from rest to a limit, and back; 0 for none. Zero velocity is sent at once [s]."""
    avoid: Annotated[Literal["all"] | tuple[str, ...], BeforeValidator(_avoided)] = ()
    """Followers to avoid in addition to neighbours; the robot receives their positions."""
    speed_step: NotNegative = 0.0
    """The robot truncates speeds to multiples of this; error feedback compensates; 0 for none [m/s]."""
    turn_rate_step: NotNegative = 0.0
    """The same for turn rates [rad/s]."""
    scanner: Literal["none", "optional", "required"] = "none"
    """Whether the robot has a range scanner; with `required` it holds while no valid scan comes."""
    scan: ScanSpec = ScanSpec()
    """The range scanner."""
    seen: SeenSpec = SeenSpec()
    """What other robots' scanners see of this robot."""

    @property
    def unseen_margin(self) -> float:
        """Width of the ring around its radius that a scanner of its model does not see; at least 0 [m]."""
        model = self.scan.scanner
        return 0.0 if model is None else max(0.0, model.range_min + abs(self.scan.mount.at) - self.radius)

    @property
    def overhang(self) -> float:
        """Distance by which its body may reach beyond what scanners see of it [m]."""
        seen = self.radius if self.seen.radius is None else self.seen.radius
        return max(0.0, self.radius + abs(self.seen.at) - seen)

    @property
    def margin(self) -> float:
        """Free distance that it keeps around its radius [m]."""
        return max(MIN_MARGIN, self.unseen_margin) if self.scan.margin is None else self.scan.margin


class RobotSpec(RobotDefaults):
    """[robots.NAME]: one robot."""

    neighbours: Annotated[tuple[Name, ...], BeforeValidator(as_tuple)] = ()
    """Robots that this robot measures and follows; empty for the leader."""
    start: Start
    """Start pose."""
    fallback_neighbours: Annotated[tuple[Name, ...], BeforeValidator(as_tuple)] = ()
    """Robots to follow while none of the neighbours can be followed."""
    first_heading_deg: float | None = None
    """First estimate of the heading observer; by default the leader's first heading [°; world frame]."""
    endpoint: Endpoint | None = None
    """Zenoh endpoint on which this robot's agent, or the leader, listens; by default on this machine."""

    @property
    def measurable(self) -> tuple[str, ...]:
        """Robots that it may measure: its neighbours, then its fallback neighbours."""
        return (*self.neighbours, *self.fallback_neighbours)

    @property
    def longest_command(self) -> float:
        """After so long a silence the watchdog stops the robot [s]: no command lasts longer."""
        return FRESH_PERIODS / self.rate

    @property
    def limits(self) -> Limits:
        """The limits as `formation.control` takes them."""
        acceleration = self.max_speed / self.ramp if self.ramp > 0.0 else math.inf
        return Limits(self.control_point_offset, self.max_speed, self.max_turn_rate, acceleration)

    @property
    def top_speed(self) -> float:
        """Fastest the control point can move [m/s]."""
        return math.hypot(self.max_speed, self.control_point_offset * self.max_turn_rate)


class SimulatedScanner(Table):
    """[simulated_scanner]: range scanners of simulated robots: values that replace those of their models."""

    beams: Annotated[int, Field(ge=4, le=4096)] | None = None
    """Beams in a full turn."""
    range_min: NotNegative | None = None
    """Shortest distance that scanners measure [m]."""
    range_max: Annotated[float, Field(gt=0.0, le=1e3)] | None = None
    """Longest distance that scanners measure [m]."""
    noise: NotNegative | None = None
    """Least standard deviation of a distance [m]; 1 µm if it is less."""
    relative_noise: NotNegative | None = None
    """Standard deviation as a share of the distance, beyond half a metre (LDS-02: 0.3 m)."""
    lost: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of beams that return no distance."""
    scale: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Systematic error of distances, as a share: each scanner measures so much too long or too short."""
    mounting_error_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.0
    """Systematic error of directions: each scanner is turned so much to the left or to the right [°]."""

    def scanner(self, scan: ScanSpec) -> Scanner:
        """A robot's scanner as `formation.sensing.raycast` takes it."""
        model = scan.scanner or LDS_01
        usual = Scanner(
            model.beams, model.range_min, model.range_max, *model.noise[:2],
            growth_distance=model.noise.growth_distance, lost=self.lost,
        )  # fmt: skip
        changes = self.model_dump(exclude={"lost", "scale", "mounting_error_deg"}, exclude_none=True)
        return usual._replace(**changes)


class Post(Table):
    """[[simulation.posts]]: a round obstacle of the simulated world."""

    x: Metres
    """x of the centre [m; world frame]."""
    y: Metres
    """y of the centre [m; world frame]."""
    radius: Positive
    """Radius [m]."""

    @property
    def disc(self) -> tuple[complex, float]:
        """Centre and radius [m]."""
        return complex(self.x, self.y), self.radius


class Wall(Table):
    """[[simulation.walls]]: a straight wall of the simulated world, without thickness."""

    begin: Point
    """x, y of one end [m; world frame]."""
    end: Point
    """x, y of the other end [m; world frame]."""

    @property
    def line(self) -> tuple[complex, complex]:
        """Both ends [m]."""
        return complex(*self.begin), complex(*self.end)
