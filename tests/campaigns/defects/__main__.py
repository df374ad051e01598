"""Deliberate defects of the product: does a rehearsal find them? Into docs/defects.md and docs/defects.json.

python -m tests.campaigns.defects [PART ...] [--jobs N] [--quick]; a part is a defect's name
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial

from tests.campaigns.defects.catalogue.all import DEFECTS
from tests.campaigns.defects.page import SHARE, text
from tests.campaigns.defects.plans import PLANS, QUICK, ordered
from tests.campaigns.defects.trial import Row, tried
from tests.campaigns.document import DOCS, stamp, update
from tests.campaigns.figures import progress
from tests.campaigns.parts import command_line

JSON, TEXT, PART = "defects.json", "defects.md", "catalogue"
EPILOG = """\
examples:
  python -m tests.campaigns.defects --jobs 2              all, into docs/; hours
  python -m tests.campaigns.defects half-plane-inverted   one; the others keep what they had
  python -m tests.campaigns.defects --quick               the first plans only, printed only

Exit code 0: enough defects are found; 1: too few are; 2: a rule breaks without any defect, or a usage error.
"""


def main(words: Sequence[str] | None = None) -> int:
    quick = f"the first {QUICK} plans"
    given = command_line("defects", __doc__, EPILOG, DEFECTS, quick).parse_args(words)
    names = list(dict.fromkeys(given.parts or DEFECTS))
    some = slice(QUICK if given.quick else None)
    began = time.monotonic()
    every: dict[str, Row] = {}
    if not given.quick and (DOCS / JSON).exists():
        before = json.loads((DOCS / JSON).read_text(encoding="utf-8"))[PART]["defects"]
        every = {row["name"]: row for row in before}
    with ThreadPoolExecutor(given.jobs) as pool:
        parts = [range(len(PLANS))[some][first :: given.jobs] for first in range(given.jobs)]
        if broken := [one for row in pool.map(partial(tried, None), parts) for one in row["broken"]]:
            progress(f"without a defect: {json.dumps(broken, ensure_ascii=False)}")
            return 2
        waiting = [pool.submit(tried, DEFECTS[name], ordered(DEFECTS[name].first)[some]) for name in names]
        for done, future in enumerate(as_completed(waiting), 1):
            row = future.result()
            every[row["name"]] = row
            progress(f"{done}/{len(names)} {row['name']}: {_words(row)}")
            if not given.quick:
                write(every, time.monotonic() - began, () if len(names) == len(DEFECTS) else names)
    found = sum(every[name]["found"] for name in names)
    print(f"{found} of {len(names)} found")
    return 0 if found >= SHARE * len(names) else 1


def write(rows: dict[str, Row], seconds: float, only: Sequence[str]) -> None:
    """Write both files; the other rows than `only`, if that names any, are of an earlier commit."""
    ordered = [rows[name] for name in DEFECTS if name in rows]
    note = {"note": f"Only tried at this commit: {', '.join(only)}."} if only else {}
    found = stamp({"plans": len(PLANS), "defects": ordered, **note}, len(ordered), seconds)
    every = update(DOCS / JSON, {PART: found}, (PART,), ascii_only=False)
    (DOCS / TEXT).write_text(text(every[PART]), encoding="utf-8")


def _words(row: Row) -> str:
    if not row["found"]:
        return "not found"
    first = row["broken"][0]
    return f"{first['rule']} after {row['plans']} plans: {first['plan']}: {first['what']}"


if __name__ == "__main__":
    sys.exit(main())
