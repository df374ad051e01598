"""Missions that differ from a shipped one in what they say of their robots."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence

from hypothesis import strategies as st

from formation.mission.file import parse, read
from formation.mission.model import Mission


def edited(text: str, table: str, keys: str) -> str:
    """`text` with the lines `keys` in its `table`, in place of what it says of the same keys there."""
    head, mark, rest = text.partition(f"[{table}]")
    assert mark, f"no table {table}"
    end = re.search(r"^\[", rest, re.MULTILINE)
    body, tail = (rest[: end.start()], rest[end.start() :]) if end else (rest, "")
    for key in re.findall(r"^(\w+) *=", keys, re.MULTILINE):
        body = re.sub(rf"^{key} *=.*\n", "", body, flags=re.MULTILINE)
    return f"{head}{mark}{body.rstrip()}\n{keys}\n\n{tail}"


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


def with_robots(name: str, **keys: str | float) -> Mission:
    """The shipped mission `name` with these keys in its [robot] table, whatever stood there."""
    return parse(with_keys(read(name)[0], **keys))


def with_keys(text: str, **keys: str | float) -> str:
    """A mission's `text` with these keys in its [robot] table, whatever stood there."""
    stated = "\n".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())
    kept = (line for line in text.split("\n") if line.split("=")[0].strip() not in keys)
    return "\n".join(f"{line}\n{stated}" if line.startswith("[robot]") else line for line in kept)


def team(
    neighbours: Mapping[str, Iterable[str]],
    fallbacks: Mapping[str, Iterable[str]] | None = None,
    **keys: str | float,
) -> Mission:
    """Robots that start in a row behind `leader`, each in its slot, and measure the given neighbours."""
    slots = {name: complex(-0.8 - 0.8 * number, 0.4 * (number % 2)) for number, name in enumerate(neighbours)}
    robot = {"control_point_offset": 0.1, "max_speed": 0.8, "max_turn_rate": 2.0, "rate": 20, **keys}
    lines = [
        'name = "team"', 'leader = "leader"', "[law]", "k_i = 0.3", "[robot]",
        *(f"{key} = {json.dumps(value)}" for key, value in robot.items()),
        "[shapes.row]", *(f"{name} = [{at.real}, {at.imag}]" for name, at in slots.items()),
        "[shapes.wide]", *(f"{name} = [{at.real}, {2.0 * at.imag}]" for name, at in slots.items()),
        "[[route]]", "speed = 0.2", "heading_deg = 0", "[robots.leader]", "start = { x = 0, y = 0 }",
    ]  # fmt: skip
    for name, at in slots.items():
        lines += [
            f"[robots.{name}]",
            f"neighbours = {json.dumps(list(neighbours[name]))}",
            f"fallback_neighbours = {json.dumps(list((fallbacks or {}).get(name, ())))}",
            f"start = {{ x = {at.real - 0.1}, y = {at.imag} }}",
        ]
    return parse("\n".join(lines))


@st.composite
def teams(draw: st.DrawFn, *, cycles: bool = True, most: int = 6) -> Mission:
    """Random graphs in which every robot has a path to the leader, with random fallbacks.

    Without `cycles`, all neighbours and fallbacks of a robot come before it.
    """
    names = [f"r{number}" for number in range(draw(st.integers(1, most)))]
    neighbours: dict[str, Sequence[str]] = {}
    fallbacks: dict[str, Sequence[str]] = {}
    for number, name in enumerate(names):
        before = ["leader", *names[:number]]
        some = draw(st.lists(st.sampled_from(before), min_size=1, max_size=2, unique=True))
        others = [one for one in ("leader", *names) if one != name] if cycles else before
        if cycles and len(some) < len(others) and draw(st.integers(0, 3)) == 0:
            some = [*some, draw(st.sampled_from([one for one in others if one not in some]))]
        neighbours[name] = some
        left = [one for one in others if one not in some]
        fallbacks[name] = draw(st.lists(st.sampled_from(left), max_size=2, unique=True)) if left else ()
    return team(neighbours, fallbacks)
