"""Missions that `formation new` writes, checked and simulated: `tests.campaigns.safety missions`."""

from __future__ import annotations

from collections.abc import Iterator

from formation.deploy.mission_files.new import PROFILES, Draft, text
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.simulation.simulate import Result, simulate
from formation.stability.analysis import analyse
from formation.stability.losses import losses


def made(shape: str, robots: int, profile: str) -> Mission:
    """The mission that `formation new` writes."""
    return parse(
        text(Draft(shape, robots, PROFILES[profile].spacing, profile)), f"{shape}-{robots}, {profile}"
    )


def faults(mission: Mission, by_chance: Result) -> Iterator[str]:
    """What is wrong with it: what `check` says, who holds after a loss, starts that go wrong.

    `by_chance` is what became of random ones.
    """
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
    if not by_chance.converged.all():
        converged = by_chance.converged
        yield f"only {converged.sum()} of {len(converged)} random starts converge"
