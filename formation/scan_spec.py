"""What a mission says of range scanners, and of what stands in a simulated world."""

from __future__ import annotations

import cmath
import math
from typing import Annotated

from pydantic import Field

from formation.raycast import Scanner
from formation.scan import Mount
from formation.tables import Metres, NotNegative, Point, Positive, Table


class ScanSpec(Table):
    """[robot.scan]: where the scanner sits, and what the protective zones go by."""

    rate: Annotated[float, Field(ge=0.5, le=100.0)] = 5.0
    """Scans per second [Hz]."""
    x: Metres = 0.0
    """Where it sits, ahead of the robot's centre [m]."""
    y: Metres = 0.0
    """… and to its left [m]."""
    yaw_deg: float = 0.0
    """Angle of its x axis from the robot's, counter-clockwise."""
    sweep: Annotated[float, Field(ge=-1.0, le=1.0)] | None = None
    """How long a scan takes from its first beam to its last [s]; by default what each scan says.

    Negative where its first beam is the newest. The driver of the LDS-01 says 0.01 s where it is -0.2 s.
    """
    margin: NotNegative = 0.05
    """Of free space that the robot keeps around its radius [m]."""
    lag: NotNegative = 0.1
    """Time constant with which the robot follows commands, thus how long it rolls on [s]."""

    @property
    def mount(self) -> Mount:
        """The scanner's place on its robot."""
        return Mount(complex(self.x, self.y), cmath.rect(1.0, math.radians(self.yaw_deg)))


class SimulatedScanner(Table):
    """[simulated_scanner]: what stands in for hardware; by default a TurtleBot3 Burger's LDS-01."""

    beams: Annotated[int, Field(ge=4, le=4096)] = 360
    """In a full turn."""
    range_min: NotNegative = 0.12
    """[m]"""
    range_max: Annotated[float, Field(gt=0.0, le=1e3)] = 3.5
    """[m]"""
    noise: NotNegative = 0.005
    """Standard deviation of a distance [m], at least."""
    relative_noise: NotNegative = 0.0175
    """The same as a share of the distance, beyond half a metre."""
    lost: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of beams that do not come back."""

    @property
    def scanner(self) -> Scanner:
        """The scanner as `formation.raycast` takes it."""
        return Scanner(**self.model_dump())


class Post(Table):
    """[[simulation.posts]]: something round that stands in a simulated world [world frame]."""

    x: Metres
    y: Metres
    radius: Positive

    @property
    def disc(self) -> tuple[complex, float]:
        """Centre and radius [m]."""
        return complex(self.x, self.y), self.radius


class Wall(Table):
    """[[simulation.walls]]: a straight wall of a simulated world, as thin as a line [world frame]."""

    begin: Point
    end: Point

    @property
    def line(self) -> tuple[complex, complex]:
        """Both ends [m]."""
        return complex(*self.begin), complex(*self.end)
