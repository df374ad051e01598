"""Whether robots are safe among each other: measured, into docs/safety.md and docs/safety.json.

python -m tests.campaigns.safety [PART ...] [--quick] [--jobs N]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from tests.campaigns.document import DOCS, Found, count, head, one_of, section, stamp, update
from tests.campaigns.figures import markdown, verdict
from tests.campaigns.safety import (
    crossing,
    gains,
    imperfect,
    missions,
    physics,
    posts,
    quiet,
    sensors,
)
from tests.campaigns.safety.part import Options, Part

PARTS: Mapping[str, Part] = {
    name: cast("Part", module)
    for name, module in {
        "crossing": crossing,
        "imperfect": imperfect,
        "posts": posts,
        "missions": missions,
        "physics": physics,
        "gains": gains,
        "sensors": sensors,
        "quiet": quiet,
    }.items()
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
    given = _flags().parse_args(words)
    held = True
    for name in dict.fromkeys(given.parts or PARTS):
        options = Options(given.quick, given.jobs, None if given.quick else DOCS / "figures")
        print(f"{name} …", file=sys.stderr, flush=True)
        began = time.monotonic()
        found = PARTS[name].run(options)
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
        bars += [(link, row["bar"], row["found"], verdict(row["held"])) for row in one["bars"]]
        sections.append(section("safety", name, part.TITLE, one, part.ABOUT, part.section(one)))
    return "\n".join([beginning, markdown(("", "asked for", "found", ""), bars), *sections])


def _flags() -> argparse.ArgumentParser:
    flags = argparse.ArgumentParser(
        prog="python -m tests.campaigns.safety",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    flags.add_argument(
        "parts",
        metavar="PART",
        nargs="*",
        type=one_of(PARTS),
        help=f"of {', '.join(PARTS)}; all by default",
    )
    flags.add_argument("--quick", action="store_true", help="a few tries, printed only; they mean little")
    flags.add_argument(
        "--jobs", type=count(64), default=1, metavar="N", help="processes side by side (default: 1)"
    )
    return flags


if __name__ == "__main__":
    sys.exit(main())
