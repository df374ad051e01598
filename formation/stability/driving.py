"""Velocities of a leader that is driven by hand: what its followers can follow."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from formation.control.plane import clip
from formation.mission.model import Mission
from formation.stability import spectrum
from formation.stability.intent import SLOT_SPEED_SHARE

SPEED_SHARE = 0.8
"""Greatest driven speed, as a share of the slowest follower's limit: the rest is for closing errors."""
RADIUS_SHARE = 1.5
"""Smallest radius that is driven, as a ratio to the smallest that followers can follow."""


class Velocity(NamedTuple):
    """Velocity of the leader's point."""

    forward: float = 0.0
    """Along its heading; negative: backwards [m/s]."""
    turn_rate: float = 0.0
    """Counter-clockwise [rad/s]."""


STANDS = Velocity()


class Limits(NamedTuple):
    """What the followers of a mission can follow."""

    speed: float
    """[m/s]"""
    turn_rate: float
    """While the leader stands [rad/s]."""
    radius: float
    """Smallest radius of its path [m]."""
    swing: float
    """Distance from the leader of the farthest slot that turns with it [m]; 0 if none does."""
    top_speed: float
    """The slowest follower's limit [m/s]."""


def limits(mission: Mission, slots: Iterable[complex], k_p: float) -> Limits:
    """Return the limits for followers in `slots` relative to the leader [m], with the gain `k_p`."""
    robots = [mission.robots[name] for name in mission.followers]
    slowest = min(robot.max_speed for robot in robots)
    turn_rate = min(robot.max_turn_rate for robot in robots)
    return Limits(
        speed=SPEED_SHARE * min(slowest, spectrum.greatest_leader_speed(mission, k_p)[1]),
        turn_rate=SPEED_SHARE * turn_rate,
        radius=RADIUS_SHARE * max(robot.control_point_offset for robot in robots),
        swing=max((abs(slot) for slot in slots), default=0.0) if mission.turning else 0.0,
        top_speed=slowest,
    )


def first_limits(mission: Mission) -> Limits:
    """Return the limits in the mission's first shape, as it is drawn."""
    return limits(mission, [mission.slot(name) for name in mission.followers], mission.gains.k_p)


def followable(wanted: Velocity, within: Limits) -> Velocity:
    """Return the velocity nearest to `wanted` that the followers can follow; speed has priority."""
    forward = clip(wanted.forward, within.speed)
    most = within.turn_rate
    if forward != 0.0:
        most = min(most, abs(forward) / within.radius)
    if within.swing > 0.0:
        most = min(most, SLOT_SPEED_SHARE * (within.top_speed - abs(forward)) / within.swing)
    return Velocity(forward, clip(wanted.turn_rate, most))
