"""Larger teams: rows of five, each robot behind the one before it and beside another."""

from __future__ import annotations

from typing import Any

from tests.campaigns.reliability.placed import dumped

ROW = 5


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
    return dumped(
        {
            "name": "crowd",
            "leader": "leader",
            "robot": {"rate": 10.0, "max_speed": 0.5, "max_turn_rate": 1.5, "radius": 0.2, "ramp": 0.5},
            "law": {"k_p": 1.5, "k_i": 0.3},
            "route": [{"speed": 0.1, "heading_deg": 0.0}],
            "shapes": {"rows": slots},
            "robots": tables,
            **(
                {"standbys": {f"standby{number}": {} for number in range(1, standbys + 1)}}
                if standbys
                else {}
            ),
        }
    )
