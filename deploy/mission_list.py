"""`formation missions`: list the shipped missions, and how to run one."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from pathlib import Path

from formation.deploy.arguments import add_json, as_json, parser, read_mission
from formation.mission.file import shipped

NEXT = """\
next:
  formation run NAME              every process of it, here
  formation check NAME            is it stable, how fast?
  formation new wedge --robots 7  a mission of your own; or copy one of these files
"""


def main(arguments: Sequence[str]) -> int:
    """List the shipped missions; return the exit code."""
    options = parser(
        "missions",
        "List the missions that are shipped: copy one, change it, name the file; or `formation new`.",
    )
    add_json(options)
    chosen = options.parse_args(arguments)
    rows = {name: (read_mission(name), path) for name, path in shipped().items()}
    if chosen.json:
        listing = {
            name: {
                "title": mission.name,
                "what": summary(path),
                "robots": len(mission.robots),
                "law": mission.law.kind,
                "shapes": list(mission.shapes),
                "standbys": list(mission.standbys),
                "file": str(path),
            }
            for name, (mission, path) in rows.items()
        }
        print(as_json({"missions": listing}))
        return 0
    for name, (mission, path) in rows.items():
        shapes = f"shape{'s' * (len(mission.shapes) > 1)} {', '.join(mission.shapes)}"
        print(f"{name}: {len(mission.followers)} followers behind {mission.leader}, {shapes}")
        print(textwrap.fill(summary(path), 100, initial_indent="  ", subsequent_indent="  "))
        print(f"  {path}\n")
    print(NEXT, end="")
    return 0


def summary(path: Path) -> str:
    """Return the first sentence of the comment at the start of a mission file."""
    comment = itertools.takewhile(
        lambda line: line.startswith("#"), path.read_text(encoding="utf-8").splitlines()
    )
    return " ".join(line.lstrip("# ") for line in comment).partition(". ")[0].rstrip(".") + "."
