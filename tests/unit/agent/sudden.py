"""How suddenly the commands of a fleet change."""

from __future__ import annotations

from itertools import pairwise

from formation.control.unicycle import AT_REST
from tests.support.fleet import Fleet


def most_sudden(fleet: Fleet, since: float = 0.0, *, rests: bool = False) -> float:
    """Largest change from one command to the next; to zero velocity only if `rests` [share of a limit]."""
    return max(
        max(
            abs(after[1] - before[1]) / fleet.mission.robots[name].max_speed,
            abs(after[2] - before[2]) / fleet.mission.robots[name].max_turn_rate,
        )
        for name, commands in fleet.commands.items()
        for before, after in pairwise(commands)
        if after[0] > since and (rests or after[1:] != AT_REST)
    )
