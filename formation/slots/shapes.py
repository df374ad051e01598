"""Shapes by generator: slots for a number of robots, relative to the leader.

x is ahead and y to the left. The leader is a point without a body: lines, columns, wedges and grids come
behind it, circles and polygons stand round it. Neighbouring slots are `spacing` apart, no two are nearer.

| generator | the robots |
|---|---|
| line | abreast, one spacing behind the leader, from left to right |
| column | one behind the other |
| wedge | a tip one spacing behind the leader, and arms 45° backwards, alternating left and right |
| circle | evenly round the leader, counter-clockwise, the first ahead |
| grid | rows and columns, as near to a square as possible; a shorter last row stands in the middle |
| polygon | one on each corner, the first ahead, the rest evenly on the sides, counter-clockwise |
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

Shape = Callable[[int, float], tuple[complex, ...]]
"""(robots, spacing [m]) -> their slots [m; from the leader, x ahead, y to the left]."""

MAX_SIDES = 6
"""Default number of corners of a polygon, at most its number of robots."""


def line(robots: int, spacing: float) -> tuple[complex, ...]:
    """Slots abreast [m; from the leader]."""
    return tuple(_row(robots, -spacing, spacing))


def column(robots: int, spacing: float) -> tuple[complex, ...]:
    """Slots one behind the other [m; from the leader]."""
    return tuple(complex(-spacing * place, 0.0) for place in range(1, robots + 1))


def wedge(robots: int, spacing: float) -> tuple[complex, ...]:
    """A tip and two arms [m; from the leader]; the tip is robot 0, then left and right by turns."""
    back = spacing * math.sqrt(0.5)
    return tuple(
        complex(-spacing - back * rank, back * rank * side)
        for rank, side in (((place + 1) // 2, 1 if place % 2 else -1) for place in range(robots))
    )


def circle(robots: int, spacing: float) -> tuple[complex, ...]:
    """Evenly round the leader [m; from the leader]; from 2 robots on."""
    radius = spacing / (2.0 * math.sin(math.pi / robots))
    return tuple(cmath.rect(radius, math.tau * place / robots) for place in range(robots))


def grid(robots: int, spacing: float) -> tuple[complex, ...]:
    """Rows behind each other, as near to a square as can be [m; from the leader]."""
    columns = math.ceil(math.sqrt(robots))
    slots: list[complex] = []
    while len(slots) < robots:
        behind = -spacing * (1 + len(slots) // columns)
        slots += _row(min(columns, robots - len(slots)), behind, spacing)
    return tuple(slots)


def polygon(robots: int, spacing: float, corners: int | None = None) -> tuple[complex, ...]:
    """A regular polygon round the leader [m; from the leader]; `corners` from 3 to `robots`.

    Sides that have a robot more than others are filled first; neighbours on them are `spacing` apart.
    """
    corners = min(MAX_SIDES, robots) if corners is None else corners
    most = math.ceil(robots / corners)
    radius = most * spacing / (2.0 * math.sin(math.pi / corners))
    slots: list[complex] = []
    for side in range(corners):
        begin, end = (cmath.rect(radius, math.tau * place / corners) for place in (side, side + 1))
        count = robots // corners + (side < robots % corners)
        slots += [begin + (end - begin) * place / count for place in range(count)]
    return tuple(slots)


SHAPES: dict[str, Shape] = {
    "line": line,
    "column": column,
    "wedge": wedge,
    "circle": circle,
    "grid": grid,
    "polygon": polygon,
}
"""The generators by name."""


def _row(robots: int, x: float, spacing: float) -> list[complex]:
    """Slots abreast at `x` with their middle behind the leader, from left to right."""
    return [complex(x, spacing * (0.5 * (robots - 1) - place)) for place in range(robots)]
