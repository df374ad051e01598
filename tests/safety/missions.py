"""Every mission that `formation new` writes, from 3 to 50 robots, checked and simulated."""

from __future__ import annotations

from itertools import product

from deploy.making.draft import PROFILES
from formation.slots.shapes import SHAPES
from tests.bench.figures import markdown
from tests.deploy.every_mission import RUNS, faults, made
from tests.safety.part import Found, Options, bar, told

TITLE = "Missions that are made"
ABOUT = f"""\
`formation new` for every shape, 3 to 50 robots, both kinds of robots. Of each mission: does `check` find a
problem or a warning, would anybody hold after the loss of any one follower, is the bound under which it
counts as converged above 5 cm, does it converge from its own starts and from {RUNS} random ones, do bodies
touch there."""
SIZES = range(3, 51)


def run(options: Options) -> Found:
    """Try all."""
    sizes = (3, 7, 16) if options.quick else SIZES
    every = list(product(PROFILES, SHAPES, sizes))
    rows = {f"{shape}, {profile}": {"tried": 0, "well": 0} for profile, shape in product(PROFILES, SHAPES)}
    wrong: list[str] = []
    for profile, shape, robots in told("missions", every):
        mission, row = made(shape, robots, profile), rows[f"{shape}, {profile}"]
        found = list(faults(mission, 5 if options.quick else RUNS))
        row["tried"] += 1
        row["well"] += not found
        wrong += [f"{mission.name}, {profile}: {fault}" for fault in found]
    well = sum(row["well"] for row in rows.values())
    words = "`formation new`, every shape and size: `check` passes and `simulate` converges, untouched"
    held = bar(words, f"{well} of {len(every)} missions", well == len(every))
    return {"rows": rows, "wrong": wrong, "bars": [held]}


def section(found: Found) -> str:
    """A table for people, and what was found wrong."""
    rows = [[name, str(row["tried"]), str(row["well"])] for name, row in found["rows"].items()]
    wrong = "".join(f"- {words}\n" for words in found["wrong"])
    return markdown(("shape, robots", "sizes", "nothing wrong"), rows) + (
        f"\nWhat was wrong:\n\n{wrong}" if wrong else ""
    )
