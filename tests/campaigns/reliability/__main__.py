"""How reliable a fleet is: tried on real processes, into docs/reliability.md and docs/reliability.json.

python -m tests.campaigns.reliability [PART ...]
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import cast

from tests.campaigns.reliability import document, failover, faults, network, sensors, shapes, soak, stop
from tests.campaigns.reliability.campaign import tell
from tests.campaigns.reliability.part import Options, Part
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
    """Try, write and say; the exit code."""
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
    found, write = {}, not (given.print or given.quick or given.only)
    for name in chosen:
        tell(f"{name}: {', '.join(rows[name])}")
        began = time.monotonic()
        one = PARTS[name].run(options)
        found[name] = document.stamp(one, tries, time.monotonic() - began)
        if write:
            document.write(document.DOCS, {name: found[name]}, PARTS)
        print(PARTS[name].section(found[name]))
    return 0 if all(one["well"] for one in found.values()) else 1


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
        "parts", metavar="PART", nargs="*", type=_one_of(parts), help=f"{', '.join(PARTS)}, or all (but soak)"
    )
    flags.add_argument("--tries", type=_count, default=20, metavar="N", help="of every row (default: 20)")
    flags.add_argument(
        "--only", action="append", default=[], metavar="ROW", help="rows whose names begin so; repeatable"
    )
    flags.add_argument(
        "--fields", type=_count, default=2, metavar="K", help="fleets side by side (default: 2)"
    )
    flags.add_argument("--minutes", type=float, default=30.0, metavar="M", help="of the soak (default: 30)")
    flags.add_argument("--keep", type=Path, metavar="DIR", help="keep what was said in tries that failed")
    flags.add_argument("--print", action="store_true", help="write nothing")
    flags.add_argument("--quick", action="store_true", help="one try (soak: one minute), and write nothing")
    return flags


def _one_of(parts: Sequence[str]) -> Callable[[str], str]:
    def part(text: str) -> str:
        if text not in parts:
            raise argparse.ArgumentTypeError(f"{text!r}: must be one of {', '.join(parts)}")
        return text

    return part


def _count(text: str) -> int:
    number = int(text) if text.isdecimal() else 0
    if not 1 <= number <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number from 1 to 1000")
    return number


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # fleets are taken down
    sys.exit(main())
