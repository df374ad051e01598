"""A block of robots, row behind row: everybody but the first row measures two of the row before."""

from __future__ import annotations

import math
from collections import Counter

from formation.mission.model import Mission

LEADER = "leader"
APART = 1.0
"""Between neighbours in a row, and between rows [m]."""
SPEED, RADIUS = 0.2, 2.0
"""The leader's, on a circle: on a straight line nobody would be off, however late [m/s; m]."""
OFFSET = 0.2
"""Control-point offset of every follower [m]."""


def width(followers: int) -> int:
    """Robots in a row: about as many as there are rows, so that nobody is far from the leader."""
    return max(2, round(math.sqrt(followers)))


def mission(followers: int, rate: float) -> str:
    """The file of a mission of so many followers, everybody at `rate` [Hz]; all start in their slots."""
    wide = width(followers)
    places = [divmod(number, wide) for number in range(followers)]
    slots = [APART * complex(-1 - row, column - 0.5 * (wide - 1)) for row, column in places]
    lines = ['name = "block"', f'leader = "{LEADER}"', "[robot]", f"control_point_offset = {OFFSET}"]
    lines += ["max_speed = 1.5", "max_turn_rate = 1.5", f"rate = {rate:g}", "[shapes.block]"]
    lines += [f"{_name(*place)} = [{at.real}, {at.imag}]" for place, at in zip(places, slots, strict=True)]
    lines += [f"[robots.{LEADER}]", "start = { x = 0.0, y = 0.0 }"]
    for (row, column), at in zip(places, slots, strict=True):
        measured = (_name(row - 1, column), _name(row - 1, (column + 1) % wide)) if row else (LEADER,)
        lines += [f"[robots.{_name(row, column)}]", f"neighbours = {list(measured)}"]
        lines += [f"start = {{ x = {at.real - OFFSET}, y = {at.imag} }}"]
    return "\n".join([*lines, "[[route]]", f"speed = {SPEED}", f"radius = {RADIUS}", "heading_deg = 0", ""])


def typical(block: Mission) -> tuple[str, ...]:
    """Followers that measure two others and are measured by two, as the first and last rows do not."""
    measured = Counter(name for robot in block.robots.values() for name in robot.neighbours)
    return tuple(
        name
        for name in block.followers
        if LEADER not in block.robots[name].neighbours and measured[name] == 2
    )


def _name(row: int, column: int) -> str:
    return f"robot{row:02}{column:02}"
