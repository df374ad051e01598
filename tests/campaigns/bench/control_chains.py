"""How an error grows along a chain behind a leader on a circle."""

from __future__ import annotations

from typing import Any

import numpy as np

from formation.simulation.body import PROFILES
from formation.simulation.ensemble import Options
from tests.campaigns.bench import routes
from tests.campaigns.bench.control_parts import Effort
from tests.campaigns.bench.control_trials import FIELD, PAPER, PROPORTIONAL, STIFF, Contender
from tests.campaigns.bench.table import slot_errors

CHAINS: dict[str, tuple[Contender, Options]] = {
    "field law": (FIELD, Options()),
    "field law, 100 ms": (FIELD, Options(delay=0.1)),
    "field law, 300 ms": (FIELD, Options(delay=0.3)),
    "field law, 30 % lost": (FIELD, Options(loss=0.3)),
    "field law, TurtleBot3": (FIELD, Options(body=PROFILES["turtlebot3_burger"])),
    "paper's law": (PAPER, Options()),
    "paper's law, 100 ms": (PAPER, Options(delay=0.1)),
    "proportional, gain 10": (PROPORTIONAL, Options()),
    "proportional, gain 10, 100 ms": (PROPORTIONAL, Options(delay=0.1)),
    "proportional, gain 40": (STIFF, Options()),
    "proportional, gain 40, 100 ms": (STIFF, Options(delay=0.1)),
}


def chains(effort: Effort) -> Any:
    """Each robot's distance from its slot, RMS over the last third [m], by hops from the leader.

    Nobody hears those behind, so one chain of fifty is every shorter chain as well.
    """
    mission = routes.circling_chain(effort.chain)
    found = {}
    for name, (contender, options) in CHAINS.items():
        result = contender.drive(
            mission, 1, effort.chain_time / contender.patience, options, starts="mission", keep=True
        )
        errors = slot_errors(mission, result)[1:]
        found[name] = np.fmin(errors, 1e6).tolist()
    return found
