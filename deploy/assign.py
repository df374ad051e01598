"""`formation assign`: assign slots and neighbours so that robots drive as little as possible."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from formation.deploy.arguments import add_json, add_mission, add_out, parser, read_mission, tell
from formation.deploy.mission_files.edit import edited
from formation.deploy.mission_files.places import Places, changes, chosen, positions
from formation.deploy.mission_files.text import check_out, is_shipped, write_mission
from formation.deploy.refusal import Refusal
from formation.deploy.terminal.units import metres
from formation.mission.file import file_of, parse
from formation.mission.model import Mission
from formation.slots.assignment import AIMS

EXAMPLES = """\
  formation assign my_mission.toml --dry-run           what would change, and how far each would go
  formation assign my_mission.toml                     the least way in all, written into the file
  formation assign my_mission.toml --least longest     the longest way is as short as possible
  formation assign six_robots --out my_mission.toml --graph keep
  formation assign my_mission.toml --positions now.json    with {"robot1": [0.4, -1.2], …}

A robot takes its slot in every shape of the mission. Comments stay where they are: read them again.
Robots in the field need what changed: `formation deploy bundle`, `formation deploy push`.
"""


def main(arguments: Sequence[str]) -> int:
    """Assign slots and neighbours; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    out = _out(options)
    at = {} if options.positions is None else positions(options.positions, mission)
    kept = options.graph == "keep"
    places = chosen(mission, _shape(options, mission), at, AIMS[options.least], keep_graph=kept)
    written = None if out is None else _write(options.mission, mission, places, out)
    end = "nothing was written"
    if written is not None:
        state = "changed" if written else "is so already"
        end = f"{out}: {state}\n\nnext:\n  formation check {quote(str(out))}"
    text = "\n".join([*words(mission, places), "", end])
    tell(options, text, lambda: report(mission, places, options.least, out))
    return 0


def words(mission: Mission, places: Places) -> Iterator[str]:
    """Yield the places for people."""
    width = max(len(name) for name in ("in all", "longest", *mission.followers)) + 2
    yield f"  {'robot':<{width}}{'takes the slot of':<{width + 14}}{'way before':<12}{'now':<10}measures"
    for name, place in places.of.items():
        other = "its own" if place == name else place
        seen = ", ".join(places.neighbours[name])
        if places.fallbacks[name]:
            seen += f", or else {', '.join(places.fallbacks[name])}"
        before, now = metres(places.before[name]), metres(places.now[name])
        yield f"  {name:<{width}}{other:<{width + 14}}{before:<12}{now:<10}{seen}"
    for title, total in (("in all", sum), ("longest", max)):
        before, now = metres(total(places.before.values())), metres(total(places.now.values()))
        yield f"  {title:<{width}}{'':<{width + 14}}{before:<12}{now}"


def report(mission: Mission, places: Places, least: str, out: Path | None) -> dict[str, Any]:
    """Return the places for a script."""
    return {
        "mission": mission.name,
        "least": least,
        "written": None if out is None else str(out),
        "distance": {
            when: {"total": sum(distances.values()), "longest": max(distances.values())}
            for when, distances in (("before", places.before), ("now", places.now))
        },
        "robots": {
            name: {
                "takes_slot_of": place,
                "distance_before": places.before[name],
                "distance_now": places.now[name],
                "neighbours": list(places.neighbours[name]),
                "fallback_neighbours": list(places.fallbacks[name]),
            }
            for name, place in places.of.items()
        },
    }


def _write(source: str, mission: Mission, places: Places, out: Path) -> bool:
    """Write the mission with these places; return whether that changed it."""
    path = file_of(source)
    with path.open(encoding="utf-8", newline="") as file:
        before = file.read()
    try:
        text = edited(before, changes(mission, places))
    except ValueError as error:
        raise Refusal(
            f"{source}: {error} cannot be changed in place; write [shapes.NAME] and [robots.NAME] with a"
            " line for each key"
        ) from None
    parse(text, source)
    if text != before or out != path:
        write_mission(out, text)
    return text != before


def _out(options: argparse.Namespace) -> Path | None:
    """Return the file to write; None for none."""
    if options.dry_run:
        return None
    if options.out is not None:
        check_out(options.out, force=options.force)
    elif Path(options.mission).is_dir():
        raise Refusal(f"{options.mission} is a folder of bundles: name the file that they are made from")
    elif is_shipped(file_of(options.mission)):
        raise Refusal(
            f"{options.mission} is shipped, and stays as it is: --out FILE for one of your own, or --dry-run"
        )
    return options.out or Path(options.mission)


def _shape(options: argparse.Namespace, mission: Mission) -> str:
    shape: str = options.shape or mission.first_shape
    if shape not in mission.shapes:
        raise Refusal(f"--shape {shape}: must be one of the mission's shapes: {', '.join(mission.shapes)}")
    return shape


def _options() -> argparse.ArgumentParser:
    options = parser("assign", "Choose each robot's slot, and the neighbours that it measures.", EXAMPLES)
    add_mission(options, law=False)
    options.add_argument(
        "--least",
        choices=AIMS,
        default="total",
        help="the way of all together, or the longest of any (default %(default)s)",
    )
    options.add_argument("--shape", metavar="NAME", help="the shape to go into (default the mission's first)")
    options.add_argument(
        "--positions",
        type=Path,
        metavar="FILE",
        help="where robots are, instead of their starts: JSON, centres in metres by name",
    )
    options.add_argument(
        "--graph",
        choices=("new", "keep"),
        default="new",
        help="measure the nearest robots that are fewer hops from the leader, or as now from slot to slot "
        "(default %(default)s)",
    )
    options.add_argument("--dry-run", action="store_true", help="only show what would change")
    add_out(options, "write there, and leave MISSION as it is")
    options.add_argument("--force", action="store_true", help="write over an --out that is there")
    add_json(options)
    return options
