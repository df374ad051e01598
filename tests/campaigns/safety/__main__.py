"""Whether robots are safe among each other: measured, into docs/safety.md and docs/safety.json.

python -m tests.campaigns.safety [PART ...] [--quick] [--jobs N]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from typing import cast

from tests.campaigns.reliability.document import DOCS, stamp
from tests.campaigns.safety import (
    crossing,
    document,
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
EPILOG = """\
examples:
  python -m tests.campaigns.safety                   all parts, into docs/; about an hour
  python -m tests.campaigns.safety crossing missions
  python -m tests.campaigns.safety --quick           a few tries of each, printed only

Each part is written as soon as it has ended; those that are not named keep the figures they had.

Exit code 0: all bars hold; 1: one does not; 2: nothing was tried.
"""


def main(words: Sequence[str] | None = None) -> int:
    """Measure, write and say; the exit code."""
    given = _flags().parse_args(words)
    held = True
    for name in dict.fromkeys(given.parts or PARTS):
        options = Options(given.quick, given.jobs, None if given.quick else DOCS / "figures")
        print(f"{name} …", file=sys.stderr, flush=True)
        began = time.monotonic()
        found = PARTS[name].run(options)
        found = stamp(found, 0, time.monotonic() - began)
        if not given.quick:
            document.write({name: found}, PARTS)
        print(document.text({name: found}, PARTS, ""), flush=True)
        held &= all(one["held"] for one in found["bars"])
    return 0 if held else 1


def _flags() -> argparse.ArgumentParser:
    flags = argparse.ArgumentParser(
        prog="python -m tests.campaigns.safety",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    flags.add_argument(
        "parts", metavar="PART", nargs="*", type=_part, help=f"of {', '.join(PARTS)}; all if none is named"
    )
    flags.add_argument("--quick", action="store_true", help="a few tries, printed only; they mean little")
    flags.add_argument(
        "--jobs", type=_count, default=1, metavar="N", help="processes side by side (default: 1)"
    )
    return flags


def _part(text: str) -> str:
    if text not in PARTS:
        raise argparse.ArgumentTypeError(f"{text!r}: must be one of {', '.join(PARTS)}")
    return text


def _count(text: str) -> int:
    number = int(text) if text.isdecimal() else 0
    if not 1 <= number <= 64:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number from 1 to 64")
    return number


if __name__ == "__main__":
    sys.exit(main())
