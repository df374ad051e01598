"""`formation new`: make a mission from a shape and a number of robots."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from formation.deploy.arguments import add_json, add_out, number, parser, tell, whole
from formation.deploy.mission_files.draft import PROFILES, Draft, text
from formation.deploy.mission_files.text import check_out, write_mission
from formation.deploy.refusal import Refusal
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.slots.shapes import MAX_SIDES, SHAPES

MAX_ROBOTS = 200
MIN_SLOT_RADII = 4.5
"""Least distance between slots [body radii]: from there on the collision filter allows every shape."""
EXAMPLES = """\
  formation new wedge --robots 7                       into wedge_7.toml
  formation new grid --robots 12 --spacing 0.8 --out field.toml
  formation new polygon --robots 9 --corners 3         a triangle
  formation new circle --robots 6 --robot paper        the paper's robots, gains and limits

The robots are robot1, robot2, …; a leader without a body goes ahead of them, or in their middle.
"""


def main(arguments: Sequence[str]) -> int:
    """Write a mission; return the exit code."""
    options = _options().parse_args(arguments)
    draft = _draft(options)
    out = options.out or Path(f"{options.shape}_{options.robots}.toml")
    check_out(out, force=options.force)
    written = text(draft)
    mission = parse(written, str(out))
    write_mission(out, written)
    tell(options, words(draft, mission, out), lambda: report(draft, mission, out))
    return 0


def words(draft: Draft, mission: Mission, out: Path) -> str:
    """Return what was written, and the next commands."""
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
    """Return what was written, for a script."""
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
    """Return the checked request."""
    profile = PROFILES[options.robot]
    spacing = profile.spacing if options.spacing is None else options.spacing
    least = MIN_SLOT_RADII * profile.radius
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
        type=whole(2, MAX_ROBOTS),
        required=True,
        metavar="N",
        help=f"how many, 2 to {MAX_ROBOTS}",
    )
    spacings = ", ".join(f"{profile.spacing:g} for {name}" for name, profile in PROFILES.items())
    least = ", ".join(f"{MIN_SLOT_RADII * profile.radius:g}" for profile in PROFILES.values())
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
        help=f"of a polygon (default {MAX_SIDES}, or as many as there are robots)",
    )
    add_out(options, "where to (default SHAPE_N.toml, here)")
    options.add_argument("--force", action="store_true", help="write over a file that is there")
    add_json(options)
    return options
