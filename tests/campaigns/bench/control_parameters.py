"""What the field law's parameters are worth, and the proportional law's gain."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.ensemble import Options
from tests.campaigns.bench import lower_bound, routes
from tests.campaigns.bench.control_parts import Effort
from tests.campaigns.bench.control_trials import SEED, UNAIDED, Contender, figures
from tests.campaigns.bench.proportional import NEAR_IDENTITY

GRID: dict[str, tuple[float, ...]] = {
    "k_p": (1.5, 2.0, 2.5, 3.0, 4.0, 6.0),
    "observer_gain": (5.0, 10.0, 20.0),
    "velocity_filter": (0.05, 0.1, 0.2),
}
"""Tried in all combinations; each of the others on its own, beside the shipped values."""
ALONE: dict[str, tuple[float, ...]] = {
    "k_i": (0.0, 0.3, 2.0),
    "anti_windup": (0.0, 3.0),
    "integral_band": (0.01, 0.1, 0.3),
    "integral_decay": (0.3, 3.0),
}
ROUGH = Options(delay=0.1, body=Body(position_noise=0.005))
"""Where parameters that are too sharp show: samples 100 ms old, positions off by 5 mm."""
STAR_GAINS = (2.0, 4.0, 6.0)
"""One neighbour instead of two asks for about twice the gain."""
PEER_GAINS = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0)


def search(effort: Effort) -> Any:
    """Field-law parameters, the same for all starts: settling, and what error is left in a rough world."""
    runs = max(20, effort.runs // 5)
    mission = routes.six_robots()
    bound = float(np.median(lower_bound.by_distance(mission, routes.drawn(mission, runs, SEED))))
    grid = [dict(zip(GRID, values, strict=True)) for values in itertools.product(*GRID.values())]
    alone = [{name: value} for name, values in ALONE.items() for value in values]
    tried = []
    for parameters in ({}, *alone[:: effort.every], *grid[:: effort.every**2]):
        one = Contender("field law", "field", parameters)
        calm = figures(one.drive(mission, runs, 25.0))
        rough = figures(one.drive(mission, max(20, runs // 3), 25.0, ROUGH))
        tried.append({"parameters": parameters, "calm": calm, "rough": rough})
    return {"runs": runs, "bound": bound, "tried": tried, "star": _star(mission, runs)}


def _star(mission: Mission, runs: int) -> Any:
    """What the graph costs: the same with every robot measuring the leader itself."""
    leader = [mission.leader]
    robots = {
        name: {**robot.model_dump(), "neighbours": leader if name in mission.followers else []}
        for name, robot in mission.robots.items()
    }
    star = routes.varied(mission, robots=robots)
    return {
        str(gain): figures(Contender("field law", "field", {"k_p": gain}).drive(star, runs, 25.0))
        for gain in STAR_GAINS
    }


def peer_gains(effort: Effort) -> Any:
    """Gains of the proportional law: what settles, and what error is left, with and without delay."""
    mission, runs = routes.six_robots(), max(20, effort.runs // 5)
    found = {}
    for gain in PEER_GAINS[:: effort.every]:
        one = Contender("proportional", NEAR_IDENTITY, {**UNAIDED, "k_p": gain})
        found[str(gain)] = {
            name: figures(one.drive(mission, runs, 30.0, Options(delay=delay)))
            for name, delay in (("calm", 0.0), ("late", 0.1))
        }
    return found


def front(tried: list[Any]) -> list[Any]:
    """Those of the tried that no other beats in both settling and the error in the rough world."""
    reliable = [one for one in tried if one["calm"]["share"] == 1.0]
    best: list[Any] = []
    for one in sorted(reliable, key=lambda one: (one["calm"]["settling"]["median"], one["rough"]["rms"])):
        if not best or one["rough"]["rms"] < best[-1]["rough"]["rms"]:
            best.append(one)
    return best
