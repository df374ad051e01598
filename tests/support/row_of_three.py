"""Missions of three followers in a row behind a leader, as the text of a file."""

from __future__ import annotations

from collections.abc import Sequence

ONE_BEHIND_ANOTHER = ('["led"]', '["a"]', '["b", "a"]')
"""Neighbours of a, b and c, as lists of the mission file."""


def row_of_three(
    name: str,
    *,
    rate: int,
    speed: float,
    neighbours: Sequence[str] = ONE_BEHIND_ANOTHER,
    behind: float = 0.1,
    takeover: str = "",
    tables: str = "",
) -> str:
    """Robots a, b and c follow led at `speed` [m/s] and `rate` [Hz]; they start `behind` [m] their slots.

    `takeover` is a line of the mission, `tables` are more tables of it.
    """
    robots = "\n".join(
        f"[robots.{one}]\nneighbours = {measured}\nstart = {{ x = {-1.0 - place - behind}, y = 0.0 }}"
        for place, (one, measured) in enumerate(zip("abc", neighbours, strict=True))
    )
    return f"""
name = "{name}"
leader = "led"
{takeover}
[robot]
rate = {rate}
[shapes.row]
a = [-1.0, 0.0]
b = [-2.0, 0.0]
c = [-3.0, 0.0]
{tables}
[robots.led]
start = {{ x = 0.0, y = 0.0 }}
{robots}
[[route]]
speed = {speed}
heading_deg = 0
"""
