"""Posts as thick as the robots' scanners, scattered at random beside the robots' ways."""

from __future__ import annotations

import random

import numpy as np
from numpy.typing import NDArray

from formation.control.plane import rotation
from formation.mission.model import Mission
from formation.mission.robot import Post
from formation.mission.route import Route

RADIUS = 0.035
"""That of a robot's scanner, so that no scan tells a post from a robot by its radius [m]."""
BESIDE = 2.0
"""How far beside the outermost ways they stand at most [m]."""
AHEAD = 0.4
"""Way that is kept clear where robots turn, ahead of them [m]."""
GAP = 0.3
"""Between the centres of two posts at least [m]."""
SECONDS, STEP_TIME = 600.0, 0.5
"""How long the robots drive, and the time between two points of their ways [s]."""


def scattered(of: Mission, real: Mission, density: float, clearance: float, seed: int) -> tuple[Post, ...]:
    """Return `density` posts a square metre [1/m²], none within `clearance` [m] of a robot's way.

    `real` has the true start poses. `seed` also determines the errors of gyroscopes.
    """
    ways, draw = ways_of(of, real, seed), random.Random(seed)
    left, right = ways.real.min() - BESIDE, ways.real.max() + BESIDE
    bottom, top = ways.imag.min() - BESIDE, ways.imag.max() + BESIDE
    found: list[complex] = []
    for _ in range(round(density * (right - left) * (top - bottom))):
        at = complex(draw.uniform(left, right), draw.uniform(bottom, top))
        if np.abs(ways - at).min() >= clearance and all(abs(at - one) >= GAP for one in found):
            found.append(at)
    return tuple(Post(x=at.real, y=at.imag, radius=RADIUS) for at in found)


def ways_of(of: Mission, real: Mission, seed: int) -> NDArray[np.complex128]:
    """Return points of the ways of all robots [m; world frame], in the physics world.

    All drift with the anchor: it starts elsewhere than it believes, and its gyroscope has a bias. Without
    that drift posts would stand in the way after two minutes.
    """
    from formation.agent.simulated.physics.world import World  # an optional package

    anchor, route = of.followers[0], Route.of(of)
    bias = float(World(real, seed)._bias[0])
    believed, true = of.robots[anchor].start, real.robots[anchor].start
    off = true.heading / believed.heading
    leader = true.position + off * (route.position(0.0) - believed.position)
    slots = np.array([of.slot(name) for name in of.followers])
    ways = [np.array([real.robots[name].start.position for name in of.followers])]
    for step in range(round(SECONDS / STEP_TIME) + 1):
        time = step * STEP_TIME
        turned = off * rotation(-bias * time)
        ways += [there := leader + turned * slots, there + AHEAD * turned * route.heading(time)]
        leader += turned * (route.position(time + STEP_TIME) - route.position(time))
    return np.concatenate(ways)
