"""`formation new`: a mission of one's own, from a shape and a number of robots."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from deploy.arguments import as_json, number, parser, whole
from deploy.making.draft import PROFILES, Draft, text
from deploy.making.text import check_out, keep
from deploy.refusal import Refusal
from formation.mission import Mission
from formation.mission_file import parse
from formation.slots.shapes import MOST_SIDES, SHAPES

MOST_ROBOTS = 200
RADII = 4.5
"""So many are between slots at least: from there on the collision filter lets bodies into every shape."""
EXAMPLES = """\
  formation new wedge --robots 7                       into wedge_7.toml
  formation new grid --robots 12 --spacing 0.8 --out field.toml
  formation new polygon --robots 9 --corners 3         a triangle
  formation new circle --robots 6 --robot paper        the paper's robots, gains and limits

The robots are robot1, robot2, …; a leader without a body goes ahead of them, or in their middle.
"""


def main(arguments: Sequence[str]) -> int:
    """Write a mission; the exit code."""
    options = _options().parse_args(arguments)
    draft = _draft(options)
    out = options.out or Path(f"{options.shape}_{options.robots}.toml")
    check_out(out, force=options.force)
    written = text(draft)
    mission = parse(written, str(out))
    keep(out, written)
    print(words(draft, mission, out))
    if options.json:
        print(as_json(report(draft, mission, out)))
    return 0


def words(draft: Draft, mission: Mission, out: Path) -> str:
    """What was written, and what to type next."""
    deepest = max(hops or 0 for hops in mission.graph.depths)
    hops = f"{deepest} hop{'' if deepest == 1 else 's'} to the leader at most"
    file = quote(str(out))
    return f"""\
{out}: {draft.robots} robots in a {draft.shape}, {draft.spacing:g} m apart, {hops}

next:
  formation check {file}
  formation simulate {file} --runs 100
  formation run {file}"""


def report(draft: Draft, mission: Mission, out: Path) -> dict[str, Any]:
    """What was written, for a script."""
    return {
        "file": str(out),
        "mission": mission.name,
        "shape": draft.shape,
        "robots": draft.robots,
        "spacing": draft.spacing,
        "profile": draft.profile,
        "edges": sum(map(len, mission.graph.neighbours)),
        "depth": max(hops or 0 for hops in mission.graph.depths),
    }


def _draft(options: argparse.Namespace) -> Draft:
    """What is asked for, checked."""
    profile = PROFILES[options.robot]
    spacing = profile.spacing if options.spacing is None else options.spacing
    least = RADII * profile.radius
    if spacing < least:
        raise Refusal(
            f"--spacing {spacing:g}: must be at least {least:g} m for robots of radius {profile.radius:g} m"
        )
    if options.shape == "polygon" and options.robots < 3:
        raise Refusal(f"--robots {options.robots}: a polygon needs at least 3")
    if options.corners is not None:
        if options.shape != "polygon":
            raise Refusal(f"--corners {options.corners}: only a polygon has corners, not a {options.shape}")
        if options.corners > options.robots:
            raise Refusal(
                f"--corners {options.corners}: must be from 3 to the number of robots, {options.robots}"
            )
    return Draft(options.shape, options.robots, spacing, options.robot, options.corners)


def _options() -> argparse.ArgumentParser:
    options = parser("new", "Write a mission: a shape of so many robots, ready to run.", EXAMPLES)
    options.add_argument("shape", metavar="SHAPE", choices=SHAPES, help=", ".join(SHAPES))
    options.add_argument(
        "--robots",
        type=whole(2, MOST_ROBOTS),
        required=True,
        metavar="N",
        help=f"how many, 2 to {MOST_ROBOTS}",
    )
    spacings = ", ".join(f"{profile.spacing:g} for {name}" for name, profile in PROFILES.items())
    least = ", ".join(f"{RADII * profile.radius:g}" for profile in PROFILES.values())
    options.add_argument(
        "--spacing",
        type=number(0.0, 100.0, open_below=True),
        metavar="M",
        help=f"between neighbouring slots [m] (default {spacings}; at least {least})",
    )
    options.add_argument(
        "--robot",
        choices=PROFILES,
        default=next(iter(PROFILES)),
        help="which robots, with gains and limits that suit them (default %(default)s)",
    )
    options.add_argument(
        "--corners",
        type=whole(3),
        metavar="K",
        help=f"of a polygon (default {MOST_SIDES}, or as many as there are robots)",
    )
    options.add_argument("--out", type=Path, metavar="FILE", help="where to (default SHAPE_N.toml, here)")
    options.add_argument("--force", action="store_true", help="write over a file that is there")
    options.add_argument("--json", action="store_true", help="one JSON object as the last line on stdout")
    return options
