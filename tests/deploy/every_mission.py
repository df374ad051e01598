"""Missions that `formation new` writes, checked and simulated: `python -m tests.safety missions`."""

from __future__ import annotations

from collections.abc import Iterator

from deploy.making.draft import PROFILES, Draft, text
from formation.mission import Mission
from formation.mission_file import parse
from formation.simulation.simulate import simulate
from formation.stability.analysis import analyse
from formation.stability.losses import losses

RUNS = 20


def made(shape: str, robots: int, profile: str) -> Mission:
    """The mission that `formation new` writes."""
    return parse(
        text(Draft(shape, robots, PROFILES[profile].spacing, profile)), f"{shape}-{robots}, {profile}"
    )


def faults(mission: Mission, runs: int = RUNS) -> Iterator[str]:
    """What is wrong with it: what `check` says, who holds after a loss, starts that go wrong."""
    found = analyse(mission)
    yield from found.problems
    yield from found.warnings
    for name, loss in losses(mission).items():
        if name != mission.leader and loss.holding:
            yield f"without {name}, {', '.join(loss.holding)} hold"
    if mission.settled > 0.05:
        yield f"counts as settled under {mission.settled:g} m"
    if not simulate(mission).converged.all():
        yield "does not converge from its own starts"
    found_by_chance = simulate(mission, runs=runs)
    converged, touched = found_by_chance.converged, found_by_chance.nearest < 0.0
    if not converged.all():
        yield f"only {converged.sum()} of {runs} random starts converge"
    if touched.any():
        yield f"robots touch in {touched.sum()} of {runs} random starts"
