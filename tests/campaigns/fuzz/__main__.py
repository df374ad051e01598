"""Damaged input for everything that reads a file: recordings, kept state, missions.

python -m tests.campaigns.fuzz {recordings,missions,state} [--mutations N] [--seed S]
"""

from __future__ import annotations

import argparse
import logging
import resource
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tests.campaigns.fuzz import missions, recordings, state
from tests.campaigns.fuzz.trying import Tried

KINDS: dict[str, Callable[[Path, range], Iterator[Tried]]] = {
    "recordings": recordings.tried,
    "missions": missions.tried,
    "state": state.tried,
}
EXAMPLES = """\
  python -m tests.campaigns.fuzz recordings --mutations 5000
  python -m tests.campaigns.fuzz state --seed 4711 --mutations 1           one mutation again

Exit code 0: nothing was found; 1: something was.
"""


def main(words: Sequence[str] | None = None) -> int:
    flags = argparse.ArgumentParser(
        "tests.campaigns.fuzz", epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    flags.add_argument("kind", choices=list(KINDS))
    flags.add_argument("--mutations", type=int, default=1000, metavar="N", help="how many (default 1000)")
    flags.add_argument("--seed", type=int, default=0, metavar="S", help="of the first one (default 0)")
    given = flags.parse_args(words)
    logging.disable(logging.CRITICAL)
    found, refused, count, slowest = Counter[str](), 0, 0, 0.0
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        for one in KINDS[given.kind](Path(folder), range(given.seed, given.seed + given.mutations)):
            count, refused, slowest = count + 1, refused + one.refused, max(slowest, one.seconds)
            if one.finding is not None:
                found[f"{one.finding.reader}: {one.finding.what}"] += 1
                print(f"seed {one.finding.seed}: {one.finding.reader}: {one.finding.what}", flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{given.mutations} mutations, {count} reads: {found.total()} findings of {len(found)} kinds, "
        f"{refused} refused, slowest {slowest:.1f} s, peak memory {peak:.0f} MB"
    )
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
