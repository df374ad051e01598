"""Posts as thick as the robots' scanners, scattered at random beside the robots' ways."""

from __future__ import annotations

import random

from formation.mission.model import Mission
from formation.mission.robot import Post
from formation.mission.route import Route

RADIUS = 0.035
"""That of a robot's scanner, so that no scan tells a post from a robot by its radius [m]."""
BESIDE = 2.0
"""How far beside the outermost slots they stand at most [m]."""
GAP = 0.3
"""Between the centres of two of them at least [m]."""
SECONDS = 600.0
"""How long the robots drive [s]."""
STEP_TIME = 0.5
"""Time between two points of a way [s]."""


def scattered(of: Mission, density: float, clearance: float, seed: int) -> tuple[Post, ...]:
    """Return `density` posts a square metre [1/m²], none within `clearance` [m] of the way of a slot."""
    route, draw = Route.of(of), random.Random(seed)
    slots = [of.slot(name) for name in of.followers]
    starts = [of.robots[name].start.position for name in of.followers]
    steps = [route.position(STEP_TIME * step) for step in range(round(SECONDS / STEP_TIME) + 1)]
    ways = [step + slot for step in steps for slot in slots]
    (left, bottom), (right, top) = _corners([*ways, *starts])
    found: list[complex] = []
    for _ in range(round(density * (right - left) * (top - bottom))):
        at = complex(draw.uniform(left, right), draw.uniform(bottom, top))
        clear = all(abs(at - one) >= clearance for one in ways)
        at_start = any(abs(at - one) < GAP for one in starts)
        if clear and not at_start and all(abs(at - one) >= GAP for one in found):
            found.append(at)
    return tuple(Post(x=at.real, y=at.imag, radius=RADIUS) for at in found)


def _corners(points: list[complex]) -> tuple[tuple[float, float], tuple[float, float]]:
    """The corners of a box that holds all points and `BESIDE` around them [m]."""
    xs, ys = [one.real for one in points], [one.imag for one in points]
    return (min(xs) - BESIDE, min(ys) - BESIDE), (max(xs) + BESIDE, max(ys) + BESIDE)
