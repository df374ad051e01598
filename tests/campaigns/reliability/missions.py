"""Missions put into a field, with a computer and an address for everybody; and those of larger teams."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from formation.mission.file import load
from formation.mission.model import Mission
from tests.support.namespaces import NETWORK

FLEET = "7460"  # port of agents, leader and standbys, each on its own computer
ROBOT = "tcp/127.0.0.1:7447"  # where a robot listens: on its own computer
STRAIGHT = {"route": [{"speed": 0.2, "heading_deg": 0.0}]}
"""Changes a mission: its leader goes on like this for ever, so that no bend has a part in what errors do."""


def placed(text: str, folder: Path, changes: Mapping[str, Any] | None = None) -> tuple[Path, Mission]:
    """The mission `text` as a file in `folder`, its members on 10.77.0.1, .2, … in their order.

    `changes` replace top-level keys; None takes one away.
    """
    data = {**tomllib.loads(text), **(changes or {})}
    data = {key: value for key, value in data.items() if value is not None}
    leader = data["leader"]
    followers = [name for name in data["robots"] if name != leader]
    data["robots"] = {name: data["robots"][name] for name in (leader, *followers)}
    members = [(table, name) for table in (data["robots"], data.get("standbys", {})) for name in table]
    for number, (table, name) in enumerate(members, 1):
        table[name] = {key: value for key, value in table[name].items() if key != "robot_endpoint"}
        table[name] |= {"endpoint": f"tcp/{NETWORK}.{number}:{FLEET}"}
    data["robot"] = {**data.get("robot", {}), "robot_endpoint": ROBOT}
    path = folder / "mission.toml"
    path.write_text(tomlkit.dumps(data), encoding="utf-8")
    return path, load(path)


ROW = 5  # robots in a row of a larger team, each behind the one before it and beside another


def crowd(robots: int, standbys: int = 0) -> str:
    """A mission of so many followers, as text. Whoever has lost its neighbours falls back on the leader."""
    names = [f"robot{number}" for number in range(1, robots + 1)]
    slots: dict[str, list[float]] = {}
    tables: dict[str, dict[str, Any]] = {"leader": {"start": {"x": 0.0, "y": 0.0}}}
    for number, name in enumerate(names):
        row, column = divmod(number, ROW)
        x, y = -1.0 - row, column - ROW // 2 + 0.0
        before = names[number - ROW] if row else "leader"
        neighbours = [before, names[number - 1]] if column else [before]
        slots[name] = [x, y]
        tables[name] = {"neighbours": neighbours, "start": {"x": x - 0.1, "y": y}}
        if "leader" not in neighbours:
            tables[name]["fallback_neighbours"] = ["leader"]
    mission = {
        "name": "crowd",
        "leader": "leader",
        "robot": {"rate": 10.0, "max_speed": 0.5, "max_turn_rate": 1.5, "radius": 0.2, "ramp": 0.5},
        "law": {"k_p": 1.5, "k_i": 0.3},
        "route": [{"speed": 0.1, "heading_deg": 0.0}],
        "shapes": {"rows": slots},
        "robots": tables,
    }
    spare = {f"standby{number}": dict[str, Any]() for number in range(1, standbys + 1)}
    return tomlkit.dumps({**mission, "standbys": spare} if spare else mission)
