"""What kind of robot is simulated: the numbers of its body.

`ideal` is the robot of Eq. (1), with the mission's limits and nothing else, so that a run of processes
differs from theory by the network alone.

`turtlebot3_burger`, after its published sources:

| number | why |
|---|---|
| 0.2108 m/s, 2.635 rad/s | clamps of the firmware, a little under the data sheet's 0.22 and 2.84 |
| 0.01 m/s, 0.01 rad/s | its node sends hundredths as whole numbers, cut off, not rounded |
| lag 0.1 s | chosen, not measured: wheels get a new goal 30 times a second, then their own loop must follow |
| position noise 0.1 mm | twice the way of one encoder tick (4096 a turn, wheel radius 33 mm) |
| heading noise 2 mrad | chosen: its gyroscope's noise after fusion |
| drift 0.5 % of the path | chosen: wheel radius known to a sixth of a millimetre, on a flat hard floor |
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from formation.mission import Mission


@dataclass(frozen=True, slots=True)
class Body:
    """What a simulated robot is made of."""

    max_speed: float = math.inf
    """Clamp of the firmware [m/s]."""
    max_turn_rate: float = math.inf
    """Clamp of the firmware [rad/s]."""
    speed_step: float = 0.0
    """Commands are cut to multiples of this, towards zero [m/s]; 0 for none."""
    turn_rate_step: float = 0.0
    """[rad/s]"""
    lag: float = 0.0
    """Time constant with which wheels follow a command [s]."""
    position_noise: float = 0.0
    """Standard deviation of each odometry sample, per axis [m]."""
    heading_noise: float = 0.0
    """Standard deviation of each odometry sample [rad]."""
    drift: float = 0.0
    """Odometry error that grows with the path, as a share of it."""


PROFILES = {
    "ideal": Body(),
    "turtlebot3_burger": Body(
        max_speed=0.2108,
        max_turn_rate=2.635,
        speed_step=0.01,
        turn_rate_step=0.01,
        lag=0.1,
        position_noise=1e-4,
        heading_noise=2e-3,
        drift=0.005,
    ),
}


def body(mission: Mission, robot: str) -> Body:
    """The body of `robot`: the mission's profile with the mission's departures from it.

    Where neither says how fast the body can be, it is as fast as the mission allows.
    """
    spec, wanted = mission.robots[robot], mission.simulated_robot
    profile = PROFILES[wanted.profile]
    if profile.max_speed == math.inf:
        profile = replace(profile, max_speed=spec.max_speed, max_turn_rate=spec.max_turn_rate)
    return replace(profile, **wanted.model_dump(exclude={"profile"}, exclude_none=True))
