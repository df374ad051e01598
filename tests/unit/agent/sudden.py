"""Largest change between consecutive commands of a fleet."""

from __future__ import annotations

from itertools import pairwise

from formation.control.unicycle import AT_REST
from tests.support.fleet import Fleet


def largest_command_change(fleet: Fleet, since: float = 0.0, *, rests: bool = False) -> float:
    """Largest change [share of a limit]; changes to zero velocity count only if `rests`."""
    return max(
        max(
            abs(after[1] - before[1]) / fleet.mission.robots[name].max_speed,
            abs(after[2] - before[2]) / fleet.mission.robots[name].max_turn_rate,
        )
        for name, commands in fleet.commands.items()
        for before, after in pairwise(commands)
        if after[0] > since and (rests or after[1:] != AT_REST)
    )
