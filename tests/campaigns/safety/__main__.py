"""Whether robots are safe among each other: measured, into docs/safety.md and docs/safety.json.

python -m tests.campaigns.safety [PART ...] [--quick] [--jobs N]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.campaigns.document import DOCS, Found, head, section, stamp, update
from tests.campaigns.figures import progress, verdict
from tests.campaigns.parts import command_line, table
from tests.campaigns.safety import crossing, gains, imperfect, missions, physics, posts, quiet, sensors
from tests.campaigns.safety.part import Options

PARTS: Mapping[str, Any] = {
    part.__name__.rpartition(".")[2]: part
    for part in (crossing, imperfect, posts, missions, physics, gains, sensors, quiet)
}
JSON, TEXT = "safety.json", "safety.md"
HEAD = """\
What keeps bodies apart: the collision filter, range scans, a world with contacts; and what changes while
robots drive. Every figure was run, at the commit that its section names.
"""
EPILOG = """\
examples:
  python -m tests.campaigns.safety                   all parts, into docs/; about an hour
  python -m tests.campaigns.safety crossing missions
  python -m tests.campaigns.safety --quick           a few tries of each, printed only

Each part is written as soon as it has ended; those that are not named keep the figures they had.

Exit code 0: all bars hold; 1: one does not; 2: nothing was tried.
"""


def main(words: Sequence[str] | None = None) -> int:
    given = command_line("safety", __doc__, EPILOG, PARTS, "a few tries, which mean little").parse_args(words)
    held = True
    for name in dict.fromkeys(given.parts or PARTS):
        progress(f"{name} …")
        began = time.monotonic()
        found = PARTS[name].run(Options(given.quick, given.jobs, None if given.quick else DOCS / "figures"))
        found = stamp(found, 0, time.monotonic() - began)
        if not given.quick:
            write({name: found})
        print(text({name: found}, ""), flush=True)
        held &= all(one["held"] for one in found["bars"])
    return 0 if held else 1


def write(found: Mapping[str, Found], folder: Path = DOCS) -> None:
    """Put `found` in place of what these parts had found before, and write both files anew."""
    every = update(folder / JSON, found, PARTS, ascii_only=False)
    words = text(every, head("Safe among each other", "safety", HEAD))
    (folder / TEXT).write_text(words, encoding="utf-8")


def text(found: Mapping[str, Found], beginning: str) -> str:
    """What people read: all bars first, then part by part."""
    bars, sections = [], []
    for name, one in found.items():
        part = PARTS[name]
        link = f"[{part.TITLE}](#{part.TITLE.lower().replace(' ', '-').replace(',', '')})"
        bars += [f"{link} | {row['bar']} | {row['found']} | {verdict(row['held'])}" for row in one["bars"]]
        sections.append(section("safety", name, part.TITLE, one, part.ABOUT, part.section(one)))
    return "\n".join([beginning, table(" | asked for | found | ", bars), *sections])


if __name__ == "__main__":
    sys.exit(main())
