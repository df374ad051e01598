"""Missions for the field: shipped missions with endpoints added."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from formation.mission.file import load
from formation.mission.model import Mission
from formation.transport.wiring import members


def in_the_field(name: str, endpoint: Callable[[int], str], team: str | None = None) -> Mission:
    """A shipped mission: robot number i (the leader is 0) listens on ``endpoint(i)``; then standbys."""
    mission = load(name)
    return listening(mission, {one: endpoint(i) for i, one in enumerate(members(mission))}, team)


def listening(mission: Mission, endpoints: Mapping[str, str | None], team: str | None = None) -> Mission:
    """The mission with these endpoints, validated again."""
    data = mission.model_dump()
    for name, endpoint in endpoints.items():
        data["robots" if name in mission.robots else "standbys"][name]["endpoint"] = endpoint
    return Mission.model_validate({**data, "team": team})


def on_a_wireless_network(number: int) -> str:
    """Endpoint of robot `number` on a wireless network."""
    return f"tls/192.168.1.{10 + number}:7460"
