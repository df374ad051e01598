"""A mission put into a field: the same mission, with a computer and an address for everybody in it."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from formation.mission.file import load
from formation.mission.model import Mission
from tests.support.namespaces import NETWORK

FLEET = "7460"
"""Port of agents, leader and standbys, each on its own computer."""
ROBOT = "tcp/127.0.0.1:7447"
"""Where a robot listens: on its own computer."""
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
    tables = [(data["robots"], name) for name in data["robots"]]
    tables += [(data.get("standbys", {}), name) for name in data.get("standbys", {})]
    for number, (table, name) in enumerate(tables, 1):
        table[name] = {key: value for key, value in table[name].items() if key != "robot_endpoint"}
        table[name] |= {"endpoint": f"tcp/{NETWORK}.{number}:{FLEET}"}
    data["robot"] = {**data.get("robot", {}), "robot_endpoint": ROBOT}
    path = folder / "mission.toml"
    path.write_text(dumped(data), encoding="utf-8")
    return path, load(path)


def dumped(data: Mapping[str, Any]) -> str:
    """TOML, one line for each top-level key."""
    return "".join(f"{key} = {_value(value)}\n" for key, value in data.items())


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)
