"""Every mission that `formation new` writes, from 3 to 50 robots, checked and simulated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import product

from formation.deploy.mission_files.new import PROFILES, Draft, text
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.simulation.simulate import Result, simulate
from formation.slots.shapes import SHAPES
from formation.stability.analysis import analyse
from formation.stability.losses import losses
from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.safety.part import Options, bar, reported


def made(shape: str, robots: int, profile: str, *, avoid: bool = True) -> Mission:
    """The mission that `formation new` writes, by default with ``--avoid``: no scanners are simulated."""
    draft = Draft(shape, robots, PROFILES[profile].spacing, profile, None, avoid)
    return parse(text(draft), f"{shape}-{robots}, {profile}")


def faults(mission: Mission, by_chance: Result) -> Iterator[str]:
    """What is wrong with it: what `check` says, which robots hold after a loss, starts that go wrong.

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


TITLE = "Missions that are made"
RUNS, SIZES = 10, range(3, 51)  # random starts of each; robots
ABOUT = f"""\
`formation new` for every shape, 3 to 50 robots, both kinds of robots. Of each mission: does `check` find a
problem or a warning, would anybody hold after the loss of any one follower, is the bound under which it
counts as converged above 5 cm, does it converge from its own starts and from {RUNS} random ones. *Touch* are
random starts in which two bodies do, which is no bar: of more than twelve robots each avoids those in the
slots around its own, and starts that are strewn widely bring others together."""


def run(options: Options) -> Found:
    sizes, runs = ((3, 7, 16), 5) if options.quick else (SIZES, RUNS)
    every = list(product(PROFILES, SHAPES, sizes))
    rows: dict[str, Counter[str]] = {}
    wrong: list[str] = []
    for profile, shape, robots in reported("missions", every):
        mission = made(shape, robots, profile)
        by_chance = simulate(mission, runs=runs)
        found = list(faults(mission, by_chance))
        touched = int((by_chance.nearest < 0.0).sum())
        rows.setdefault(f"{shape}, {profile}", Counter()).update(
            tried=1, well=int(not found), starts=runs, touched=touched
        )
        wrong += [f"{mission.name}, {profile}: {fault}" for fault in found]
    well = sum(row["well"] for row in rows.values())
    words = "what `formation new` makes passes `check` and converges, every shape, 3 to 50 robots"
    held = bar(words, f"{well} of {len(every)} missions", well == len(every))
    return {"rows": rows, "wrong": wrong, "bars": [held]}


def section(found: Found) -> str:
    rows = [
        f"{name} | {row['well']} of {row['tried']} | {row['touched']} of {row['starts']}"
        for name, row in found["rows"].items()
    ]
    wrong = "".join(f"- {words}\n" for words in found["wrong"])
    tried = table("shape, robots | sizes with nothing wrong | random starts that touch", rows)
    return tried + (f"\nWhat was wrong:\n\n{wrong}" if wrong else "")
