"""How reliable a fleet is: tried on real processes, into docs/reliability.md and docs/reliability.json.

python -m tests.campaigns.reliability [PART ...]
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.campaigns.document import DOCS, Found, count, head, section, stamp, update
from tests.campaigns.parts import command_line
from tests.campaigns.reliability import (
    campaign,
    failover,
    faults,
    network,
    orders,
    sensors,
    shapes,
    soak,
    stop,
)
from tests.campaigns.reliability.campaign import Options, tell
from tests.support.needs import missing

PARTS: Mapping[str, Any] = {
    part.__name__.rpartition(".")[2]: part
    for part in (faults, sensors, network, stop, orders, failover, shapes, soak)
}
"""Modules with a TITLE, ABOUT (what was done, in sentences), NAMES of their rows, and `run(options)`.

What `run` gives has ``well``, whether all was as it should be. Some have a `section(found)` of their own, and
`draw(found, folder)` for a picture.
"""
ALL = tuple(name for name in PARTS if name != "soak")
JSON, TEXT = "reliability.json", "reliability.md"
HEAD = """\
Real processes, each robot on a computer of its own: network namespaces, whose veth pairs end at one bridge.
An agent, a watchdog and a simulated robot on each, with the command lines they have in the field; a leader,
standbys, a monitor that records. A witness, which is no part of the fleet, looks on by a network of its own
and writes down every command that reaches a robot's wheels, where each robot truly is, and everything said
as the leader. All verdicts are made of that.

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

A part that is run anew takes its own place in docs/ and leaves the others as they are; with --only or
--quick nothing is written. It needs root, ip and nft, as tests marked `namespaces` do.

Exit code 0: all was as it should be; 1: something was not; 2: nothing was tried.
"""


def main(words: Sequence[str] | None = None) -> int:
    flags = command_line("reliability", __doc__, EXAMPLES, PARTS, "one try (soak: one minute)", jobs=2)
    flags.add_argument(
        "--tries", type=count(1000), default=20, metavar="N", help="of every row (default: 20)"
    )
    flags.add_argument(
        "--only", action="append", default=[], metavar="ROW", help="rows whose names begin so; repeatable"
    )
    flags.add_argument("--minutes", type=float, default=30.0, metavar="M", help="of the soak (default: 30)")
    flags.add_argument("--keep", type=Path, metavar="DIR", help="keep what was said in tries that failed")
    given = flags.parse_args(words)
    if lacking := missing("namespaces"):
        print(f"reliability: needs {lacking}", file=sys.stderr)
        return 2
    tries, minutes = (1, 1.0) if given.quick else (given.tries, given.minutes)
    options = Options(tries, given.jobs, tuple(given.only), given.keep, minutes)
    rows = {name: list(filter(options.chosen, PARTS[name].NAMES)) for name in given.parts or ALL}
    if not any(rows.values()):
        legal = ", ".join(row for name in rows for row in PARTS[name].NAMES)
        flags.error(f"--only {', '.join(given.only)}: must begin one of {legal}")
    well = True
    for name in [name for name in rows if rows[name]]:
        tell(f"{name}: {', '.join(rows[name])}")
        began = time.monotonic()
        found = stamp(PARTS[name].run(options), tries, time.monotonic() - began)
        if not (given.quick or given.only):
            write({name: found})
        print(_section(name, found))
        well &= found["well"]
    return 0 if well else 1


def write(found: Mapping[str, Found], folder: Path = DOCS) -> None:
    """Put `found` in place of what these parts had found before, and write both files and pictures anew."""
    sections = []
    for name, one in update(folder / JSON, found, PARTS).items():
        part = PARTS[name]
        verdict = "all as it should be" if one["well"] else "**not all as it should be**"
        title, words = f"{part.TITLE}: {verdict}", _section(name, one)
        sections.append(section("reliability", name, title, one, part.ABOUT, words))
        if name in found and (draw := getattr(part, "draw", None)):
            draw(one, folder)
    every = [head("Reliability", "reliability", HEAD), *sections]
    (folder / TEXT).write_text("\n".join(every), encoding="utf-8")


def _section(name: str, found: Found) -> str:
    return str(getattr(PARTS[name], "section", campaign.section)(found))


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # fleets are taken down
    sys.exit(main())
