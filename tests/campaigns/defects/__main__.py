"""Deliberate defects of the product: does a rehearsal find them? Into docs/defects.md and docs/defects.json.

python -m tests.campaigns.defects [NAME ...] [--jobs N] [--quick]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any

from tests.campaigns.defects.catalogue.all import DEFECTS
from tests.campaigns.defects.page import text
from tests.campaigns.defects.plans import PLANS, QUICK, ordered
from tests.campaigns.defects.trial import Row, tried
from tests.campaigns.document import DOCS, count, one_of, stamp, update

JSON, TEXT, PART = "defects.json", "defects.md", "catalogue"
EPILOG = """\
examples:
  python -m tests.campaigns.defects --jobs 2              all, into docs/; hours
  python -m tests.campaigns.defects half-plane-inverted   one; the others keep what they had
  python -m tests.campaigns.defects --quick               the first plans only, printed only

Exit code 0: enough defects are found; 1: too few are; 2: a rule breaks without any defect, or a usage error.
"""


def main(words: Sequence[str] | None = None) -> int:
    given = _flags().parse_args(words)
    names = list(dict.fromkeys(given.names or DEFECTS))
    numbers = range(QUICK if given.quick else len(PLANS))
    began = time.monotonic()
    if broken := _sound(numbers, given.jobs):
        print(f"without a defect: {json.dumps(broken, ensure_ascii=False)}", file=sys.stderr)
        return 2
    every: dict[str, Row] = {} if given.quick else _before()
    with ThreadPoolExecutor(given.jobs) as pool:
        waiting = [pool.submit(tried, DEFECTS[name], _numbers(name, quick=given.quick)) for name in names]
        for done, future in enumerate(as_completed(waiting)):
            row = future.result()
            every[row["name"]] = row
            _tell(row, done + 1, len(names))
            if not given.quick:
                write(every, time.monotonic() - began, () if len(names) == len(DEFECTS) else names)
    found = sum(every[name]["found"] for name in names)
    print(f"{found} of {len(names)} found")
    return 0 if found >= 0.95 * len(names) else 1


def _numbers(name: str, *, quick: bool) -> list[int]:
    """The plans that a defect meets, in order."""
    return ordered(DEFECTS[name].first)[: QUICK if quick else None]


def write(rows: dict[str, Row], seconds: float, only: Sequence[str]) -> None:
    """Write both files; the other rows than `only`, if that names any, are of an earlier commit."""
    ordered = [rows[name] for name in DEFECTS if name in rows]
    note = {"note": f"Only tried at this commit: {', '.join(only)}."} if only else {}
    found: dict[str, Any] = stamp({"plans": len(PLANS), "defects": ordered, **note}, len(ordered), seconds)
    every = update(DOCS / JSON, {PART: found}, (PART,), ascii_only=False)
    (DOCS / TEXT).write_text(text(every[PART]), encoding="utf-8")


def _before() -> dict[str, Row]:
    path = DOCS / JSON
    if not path.exists():
        return {}
    rows = json.loads(path.read_text(encoding="utf-8"))[PART]["defects"]
    return {row["name"]: row for row in rows}


def _sound(numbers: Sequence[int], jobs: int) -> list[Row]:
    """The rules that break without a defect."""
    parts = [numbers[first::jobs] for first in range(jobs)]
    with ThreadPoolExecutor(jobs) as pool:
        return [broken for row in pool.map(lambda part: tried(None, part), parts) for broken in row["broken"]]


def _tell(row: Row, done: int, of: int) -> None:
    what = "not found"
    if row["found"]:
        first = row["broken"][0]
        what = f"{first['rule']} after {row['plans']} plans: {first['plan']}: {first['what']}"
    print(f"{done}/{of} {row['name']}: {what}", file=sys.stderr, flush=True)


def _flags() -> argparse.ArgumentParser:
    flags = argparse.ArgumentParser(
        prog="python -m tests.campaigns.defects",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    flags.add_argument(
        "names", metavar="NAME", nargs="*", type=one_of(DEFECTS), help="of the catalogue; all by default"
    )
    flags.add_argument("--quick", action="store_true", help=f"the first {QUICK} plans, printed only")
    flags.add_argument(
        "--jobs", type=count(64), default=1, metavar="N", help="processes side by side (default: 1)"
    )
    return flags


if __name__ == "__main__":
    sys.exit(main())
