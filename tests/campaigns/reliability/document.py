"""docs/reliability.json and docs/reliability.md: every part with when, how often and at which commit."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from tests.campaigns.bench.figures import rounded
from tests.campaigns.reliability import plots
from tests.campaigns.reliability.part import Found, Part

DOCS = Path(__file__).parents[3] / "docs"
JSON, TEXT = "reliability.json", "reliability.md"
HEAD = """\
# Reliability

Written, with [the same figures for programs](reliability.json), by

```sh
python3 deploy/env.py python -m tests.campaigns.reliability
```

Real processes, each robot on a computer of its own: network namespaces, whose veth pairs end at one bridge.
An agent, a watchdog and a simulated robot on each, with the command lines they have in the field; a leader,
standbys, a monitor that records. A witness who belongs to nobody looks on by a network of its own and
writes down every command that reaches a robot's wheels, where each robot truly is, and everything said as the
leader. All verdicts are made of that.

- *Formation error*: the distances of all edges from what the shape in force asks for, added up, of true
  control points. It is *back* when it stays under 2 cm for a second; *after* counts from when the fault was
  undone.
- *Largest command*, *largest jump* (from one command at the wheels to the next): in per cent of the robot's
  limit, over all robots and tries. A jump to zero velocity is what a failsafe does, and is not counted.
- A try is *as it should be* if no command was above a limit or jumped by more than 50 % of one, never two
  processes led at once, no process ended by itself, the error came back, and what the part's own lines say.
- Times are median and, in brackets, worst.
"""


def stamp(found: Found, tries: int, seconds: float) -> Found:
    """A part's figures with when, where and how often."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": commit(),
        "machine": machine(),
        "tries": tries,
        "took": seconds,
        **found,
    }


def write(folder: Path, found: Mapping[str, Found], parts: Mapping[str, Part]) -> None:
    """Put `found` in place of what these parts had found before, and write both files anew."""
    every = {**before(folder), **rounded(dict(found))}
    ordered = {name: every[name] for name in parts if name in every}
    (folder / JSON).write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    for name in found:
        plots.draw(name, found[name], folder)
    sections = [_section(name, parts[name], one) for name, one in ordered.items()]
    (folder / TEXT).write_text("\n".join([HEAD, *sections]), encoding="utf-8")


def before(folder: Path) -> dict[str, Found]:
    """What was found before, by part."""
    path = folder / JSON
    found: dict[str, Found] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return found


def commit() -> str:
    """Of this checkout; with a + if anything but these documents has been changed since."""
    git = ("git", "-C", str(DOCS.parent))
    name = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    changes = (*git, "status", "--porcelain", "--untracked-files=no", "--", ":(top)", ":(top,exclude)docs")
    dirty = subprocess.run(changes, capture_output=True, text=True, check=False)
    return name.stdout.strip() + "+" * bool(dirty.stdout.strip()) if name.returncode == 0 else "unknown"


def machine() -> str:
    """What it ran on."""
    python = f"{platform.system()}, Python {platform.python_version()}"
    return (
        f"{os.cpu_count()} cores of {platform.machine()}, {python}, eclipse-zenoh {version('eclipse-zenoh')}"
    )


def _section(name: str, part: Part, found: Found) -> str:
    verdict = "all as it should be" if found["well"] else "**not all as it should be**"
    where = f"{found['date']}, commit {found['commit']}, {found['machine']}; {found['took'] / 60.0:.0f} min"
    command = f"python3 deploy/env.py python -m tests.campaigns.reliability {name}"
    return (
        f"## {part.TITLE}: {verdict}\n\n```sh\n{command}\n```\n\n"
        f"{where}.\n\n{part.ABOUT}\n\n{part.section(found)}"
    )
