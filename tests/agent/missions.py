"""Missions that differ from a shipped one in what they say of their robots."""

from __future__ import annotations

from formation.mission import Mission
from formation.mission_file import parse, read


def with_robots(name: str, **keys: str | float) -> Mission:
    """The shipped mission `name` with these keys in its [robot] table, whatever stood there."""
    lines: list[str] = []
    for line in read(name)[0].split("\n"):
        if line.split("=")[0].strip() not in keys:
            lines.append(line)
        if line.startswith("[robot]"):
            lines += [f'{key} = "{v}"' if isinstance(v, str) else f"{key} = {v}" for key, v in keys.items()]
    return parse("\n".join(lines))
