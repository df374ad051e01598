"""The simulated body: the effect of a command, and errors of the odometry.

Pure. `ideal` is the robot of Eq. (1), which follows commands at once and exactly.
`turtlebot3_burger`, after its published sources:

| number | why |
|---|---|
| 0.2108 m/s, 2.635 rad/s | clamps of the firmware, a little under the data sheet's 0.22 and 2.84 |
| 0.01 m/s, 0.01 rad/s | its node sends hundredths as whole numbers, cut off, not rounded |
| lag 0.1 s | chosen, not measured: wheels get a new goal 30 times a second, then their own loop must follow |
| position noise 0.1 mm | twice the distance of one encoder tick (4096 a turn, wheel radius 33 mm) |
| heading noise 2 mrad | chosen: its gyroscope's noise after fusion |
| drift 0.5 % of the path | chosen: wheel radius known to a sixth of a millimetre, on a flat hard floor |
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from formation.control.plane import clip
from formation.control.unicycle import Command
from formation.mission.model import SimulatedRobot


class Body(NamedTuple):
    """A robot's drive and odometry."""

    lag: float = 0.0
    """Time constant of the wheels, first order [s]."""
    max_speed: float = float("inf")
    """Clamp of the firmware [m/s]."""
    max_turn_rate: float = float("inf")
    """Clamp of the firmware [rad/s]."""
    speed_step: float = 0.0
    """Commands are cut to multiples of this, towards zero [m/s]; 0 for none."""
    turn_rate_step: float = 0.0
    """The same for turn rates [rad/s]."""
    position_noise: float = 0.0
    """Standard deviation of each odometry position, per axis [m]."""
    heading_noise: float = 0.0
    """Standard deviation of each odometry heading [rad]; the law does not read it."""
    drift: float = 0.0
    """Odometry error that grows with the path, as a share of it."""

    @staticmethod
    def of(spec: SimulatedRobot) -> Body:
        """The body of a mission's [simulated_robot]: its profile, and changes to it."""
        return PROFILES[spec.profile]._replace(**spec.model_dump(exclude={"profile"}, exclude_none=True))


def obeyed(body: Body, command: Command) -> Command:
    """The command as the firmware takes it: cut to steps, then clamped."""
    return Command(
        clip(_cut(command.speed, body.speed_step), body.max_speed),
        clip(_cut(command.turn_rate, body.turn_rate_step), body.max_turn_rate),
    )


def _cut(value: float, step: float) -> float:
    """`value` cut towards zero to a multiple of `step`; rounding errors of a multiple are ignored."""
    if step <= 0.0:
        return value
    return math.copysign(math.floor(abs(value) / step + 1e-6), value) * step


PROFILES: Mapping[str, Body] = MappingProxyType(
    {
        "ideal": Body(),
        "turtlebot3_burger": Body(
            lag=0.1,
            max_speed=0.2108,
            max_turn_rate=2.635,
            speed_step=0.01,
            turn_rate_step=0.01,
            position_noise=1e-4,
            heading_noise=2e-3,
            drift=0.005,
        ),
    }
)
"""Bodies that a mission may name."""
