"""Missions for the field: the shipped ones with endpoints, which those do without."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from formation.mission import Mission
from formation.mission_file import load


def in_the_field(name: str, endpoint: Callable[[int], str], team: str | None = None) -> Mission:
    """A shipped mission whose robot number i (the leader is 0) listens on ``endpoint(i)``."""
    mission = load(name)
    return listening(mission, {robot: endpoint(i) for i, robot in enumerate(mission.names)}, team)


def listening(mission: Mission, endpoints: Mapping[str, str | None], team: str | None = None) -> Mission:
    """A mission with other endpoints, and checked again."""
    data = mission.model_dump()
    for robot, endpoint in endpoints.items():
        data["robots"][robot]["endpoint"] = endpoint
    return Mission.model_validate({**data, "team": team})


def on_a_wireless_network(number: int) -> str:
    """An endpoint as in a field."""
    return f"tls/192.168.1.{10 + number}:7460"
