"""[robot] and [robots.NAME] of a mission file: one robot, and what all have in common."""

from __future__ import annotations

import cmath
import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from formation.endpoint import Endpoint
from formation.law import Limits
from formation.neighbour import FRESH_PERIODS
from formation.scan_spec import ScanSpec
from formation.tables import Metres, Name, Namespace, NotNegative, Positive, Ros, Speed, Table, as_tuple


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


def _minded(value: Any) -> Any:
    """A list as TOML has it, as a tuple; what is neither that nor "all" is refused in one sentence."""
    value = as_tuple(value)
    if value == "all" or (isinstance(value, tuple) and all(isinstance(one, str) for one in value)):
        return value
    raise PydanticCustomError("minded", 'Input should be "all" or a list of robots')


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
    ramp: Annotated[float, Field(ge=0.0, le=10.0)] = 0.25
    """From rest to a limit takes a command at least so long, and as long back; 0 for at once [s].
    Zero velocity never waits."""
    mind: Annotated[Literal["all"] | tuple[str, ...], BeforeValidator(_minded)] = ()
    """Followers out of whose way it gets, beside those whom it measures; it hears their positions."""
    speed_step: NotNegative = 0.0
    """The robot cuts commands to multiples of this, which error feedback makes up for [m/s]; 0 for none."""
    turn_rate_step: NotNegative = 0.0
    """[rad/s]"""
    scanner: Literal["none", "optional", "required"] = "none"
    """Whether it has a range scanner to mind, and whether it holds while that is silent."""
    scan: ScanSpec = ScanSpec()


class RobotSpec(RobotDefaults):
    """[robots.NAME]: one robot."""

    neighbours: Annotated[tuple[Name, ...], BeforeValidator(as_tuple)] = ()
    start: Start
    fallback_neighbours: Annotated[tuple[Name, ...], BeforeValidator(as_tuple)] = ()
    """Whom it measures while none of its neighbours can be followed, and no longer."""
    first_heading_deg: float | None = None
    """First guess of the heading observer; by default the leader's first heading."""
    endpoint: Endpoint | None = None
    """Where this robot's agent (or the leader) listens."""

    @property
    def measurable(self) -> tuple[str, ...]:
        """Whom it may come to measure: its neighbours, then its fallbacks."""
        return (*self.neighbours, *self.fallback_neighbours)

    @property
    def longest_command(self) -> float:
        """After so long a silence the guard stops the robot [s]: no command lasts longer."""
        return FRESH_PERIODS / self.rate

    @property
    def limits(self) -> Limits:
        """The limits as `formation.law` takes them."""
        return Limits(self.control_point_offset, self.max_speed, self.max_turn_rate)

    @property
    def top_speed(self) -> float:
        """Fastest the control point can move [m/s]."""
        return math.hypot(self.max_speed, self.control_point_offset * self.max_turn_rate)
