"""What a mission says of range scanners, and of what stands in a simulated world."""

from __future__ import annotations

import cmath
import math
from typing import Annotated

from pydantic import Field

from formation.mission.tables import Metres, NotNegative, Point, Positive, Table
from formation.sensing.raycast import Scanner
from formation.sensing.scan import Mount


class ScanSpec(Table):
    """[robot.scan]: where the scanner is mounted, and parameters of the protective zone."""

    rate: Annotated[float, Field(ge=0.5, le=100.0)] = 5.0
    """Scans per second [Hz]."""
    x: Metres = 0.0
    """Position of the scanner, ahead of the robot's centre [m]."""
    y: Metres = 0.0
    """Position of the scanner, to the left of the robot's centre [m]."""
    yaw_deg: float = 0.0
    """Angle of the scanner's x axis from the robot's, counter-clockwise [°]."""
    sweep: Annotated[float, Field(ge=-1.0, le=1.0)] | None = None
    """Time from a scan's first beam to its last; by default as each scan states [s].

    Negative if the first beam is the newest. The driver of the LDS-01 states 0.01 s; correct is -0.2 s.
    """
    margin: NotNegative = 0.05
    """Free distance that the robot keeps around its radius [m]."""
    lag: NotNegative = 0.1
    """Time constant with which the robot follows commands; its stopping distance follows from it [s]."""

    @property
    def mount(self) -> Mount:
        """The scanner's place on its robot."""
        return Mount(complex(self.x, self.y), cmath.rect(1.0, math.radians(self.yaw_deg)))


class SimulatedScanner(Table):
    """[simulated_scanner]: range scanner of simulated robots; by default a TurtleBot3 Burger's LDS-01."""

    beams: Annotated[int, Field(ge=4, le=4096)] = 360
    """Beams in a full turn."""
    range_min: NotNegative = 0.12
    """Shortest distance that the scanner measures [m]."""
    range_max: Annotated[float, Field(gt=0.0, le=1e3)] = 3.5
    """Longest distance that the scanner measures [m]."""
    noise: NotNegative = 0.005
    """Least standard deviation of a distance [m]."""
    relative_noise: NotNegative = 0.0175
    """Standard deviation as a share of the distance, beyond half a metre."""
    lost: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of beams that return no distance."""

    @property
    def scanner(self) -> Scanner:
        """The scanner as `formation.sensing.raycast` takes it."""
        return Scanner(**self.model_dump())


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
