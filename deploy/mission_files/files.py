"""`formation missions` lists the shipped missions; mission files of other commands are written here."""

from __future__ import annotations

import itertools
import os
import textwrap
from collections.abc import Sequence
from pathlib import Path

from formation.deploy.arguments import add_json, as_json, check_file, parser, read_mission, replacing
from formation.deploy.refusal import Refusal, refuse_os_errors
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
        "  formation missions\n  formation missions --json    names, shapes, laws and files, for a script\n",
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


def write_mission(path: Path, text: str) -> None:
    """Write a file, completely or not at all; line ends are as in `text`. Raises Refusal."""
    target = Path(os.path.realpath(path))  # write to the target of a link, not the link
    with refuse_os_errors(f"{path}: cannot be written"):
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
        with replacing(target) as new:
            new.write_text(text, encoding="utf-8", newline="")
            new.chmod(mode)


def check_out(out: Path, *, force: bool) -> None:
    """Make the folder of a mission file to write; raise Refusal for a path that cannot be one."""
    check_file("--out", out, ".toml")
    if is_shipped(out):
        raise Refusal(f"--out {out}: is shipped, and is not changed; name another file")
    if out.exists() and not force:
        raise Refusal(f"--out {out}: exists already; name another file, or overwrite it with --force")


def is_shipped(mission: Path) -> bool:
    """Return whether this is a mission of the package, also through links."""
    # not Path.resolve, which has an error of its own for links in a circle
    return os.path.realpath(mission) in {os.path.realpath(path) for path in shipped().values()}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
