"""How reliable a fleet is: tried on real processes, into docs/reliability.md and docs/reliability.json.

python -m tests.campaigns.reliability [PART ...]
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from tests.campaigns.document import DOCS, Found, count, head, one_of, section, stamp, update
from tests.campaigns.reliability import failover, faults, network, sensors, shapes, soak, stop
from tests.campaigns.reliability.campaign import Options, Part, tell
from tests.support.needs import missing

PARTS: Mapping[str, Part] = {
    name: cast("Part", module)
    for name, module in {
        "faults": faults,
        "sensors": sensors,
        "network": network,
        "stop": stop,
        "failover": failover,
        "shapes": shapes,
        "soak": soak,
    }.items()
}
ALL = tuple(name for name in PARTS if name != "soak")
JSON, TEXT = "reliability.json", "reliability.md"
HEAD = """\
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
EXAMPLES = """\
examples:
  python -m tests.campaigns.reliability                          everything but the soak, 20 tries, into docs/
  python -m tests.campaigns.reliability faults --tries 3
  python -m tests.campaigns.reliability faults --only kill --only pause-leader
  python -m tests.campaigns.reliability network --quick              one try, printed only
  python -m tests.campaigns.reliability soak --minutes 30
  python -m tests.campaigns.reliability failover --keep /tmp/why     logs and traces of tries that fail

A part that is run anew takes its own place in docs/ and leaves the others as they are; with --only, --quick
or --print nothing is written. It needs root, ip and nft, as tests marked `namespaces` do.

Exit code 0: all was as it should be; 1: something was not; 2: nothing was tried.
"""


def main(words: Sequence[str] | None = None) -> int:
    flags = _flags()
    given = flags.parse_args(words)
    if lacking := missing("namespaces"):
        print(f"reliability: needs {lacking}", file=sys.stderr)
        return 2
    chosen = list(dict.fromkeys(ALL if "all" in given.parts or not given.parts else given.parts))
    tries = 1 if given.quick else given.tries
    options = Options(
        tries, given.fields, tuple(given.only), given.keep, 1.0 if given.quick else given.minutes
    )
    rows = {name: [row for row in PARTS[name].names() if options.chosen(row)] for name in chosen}
    if not any(rows.values()):
        legal = ", ".join(row for name in chosen for row in PARTS[name].names())
        flags.error(f"--only {', '.join(given.only)}: must begin one of {legal}")
    chosen = [name for name in chosen if rows[name]]
    _estimate(chosen, rows, options)
    found, kept = {}, not (given.print or given.quick or given.only)
    for name in chosen:
        tell(f"{name}: {', '.join(rows[name])}")
        began = time.monotonic()
        one = PARTS[name].run(options)
        found[name] = stamp(one, tries, time.monotonic() - began)
        if kept:
            write({name: found[name]})
        print(PARTS[name].section(found[name]))
    return 0 if all(one["well"] for one in found.values()) else 1


def write(found: Mapping[str, Found], folder: Path = DOCS) -> None:
    """Put `found` in place of what these parts had found before, and write both files and pictures anew."""
    sections = []
    for name, one in update(folder / JSON, found, PARTS).items():
        part = PARTS[name]
        verdict = "all as it should be" if one["well"] else "**not all as it should be**"
        about = (part.ABOUT, part.section(one))
        sections.append(section("reliability", name, f"{part.TITLE}: {verdict}", one, *about))
        if name in found and (draw := getattr(part, "draw", None)):
            draw(one, folder)
    words = [head("Reliability", "reliability", HEAD), *sections]
    (folder / TEXT).write_text("\n".join(words), encoding="utf-8")


def _estimate(chosen: Sequence[str], rows: Mapping[str, Sequence[str]], options: Options) -> None:
    seconds = 0.0
    for name in chosen:
        part = PARTS[name]
        share = len(rows[name]) / len(part.names())
        seconds += options.minutes * 60.0 if name == "soak" else part.seconds(options) * share
    tell(f"{options.tries} tries on {options.fields} fleets: about {seconds / 60.0:.0f} min")


def _flags() -> argparse.ArgumentParser:
    flags = argparse.ArgumentParser(
        prog="python -m tests.campaigns.reliability",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parts = (*PARTS, "all")
    flags.add_argument(
        "parts", metavar="PART", nargs="*", type=one_of(parts), help=f"{', '.join(PARTS)}, or all (but soak)"
    )
    flags.add_argument(
        "--tries", type=count(1000), default=20, metavar="N", help="of every row (default: 20)"
    )
    flags.add_argument(
        "--only", action="append", default=[], metavar="ROW", help="rows whose names begin so; repeatable"
    )
    flags.add_argument(
        "--fields", type=count(1000), default=2, metavar="K", help="fleets side by side (default: 2)"
    )
    flags.add_argument("--minutes", type=float, default=30.0, metavar="M", help="of the soak (default: 30)")
    flags.add_argument("--keep", type=Path, metavar="DIR", help="keep what was said in tries that failed")
    flags.add_argument("--print", action="store_true", help="write nothing")
    flags.add_argument("--quick", action="store_true", help="one try (soak: one minute), and write nothing")
    return flags


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # fleets are taken down
    sys.exit(main())
