"""The command line of what is measured against the number of robots."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.campaigns.bench.accounting import LISTING
from tests.campaigns.bench.fleet import SETTLE
from tests.campaigns.figures import curve_flags, show

QUICK = (2.0, 4.0)
"""How long a fleet settles and is measured in the short form [s]."""


def run(
    description: str | None,
    measure: Callable[[tuple[int, ...], int, float, float], Any],
    counts: tuple[int, ...],
    quick_counts: tuple[int, ...],
    draw: Callable[[Any, Path], None],
    section: Callable[[Any], str],
) -> None:
    """Measure with so many robots, draw what is found if asked to, and print it.

    `measure` is given the numbers of robots, of rounds, and how long each fleet settles and is measured [s].
    """
    parser = curve_flags(description, rounds=2)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    given = parser.parse_args()
    if shutil.which(LISTING[0]) is None:
        parser.error(f"needs {LISTING[0]}, which counts what goes over each link: apt install iproute2")
    if given.quick:
        found = measure(quick_counts, 1, *QUICK)
    else:
        found = measure(counts, given.rounds, SETTLE, given.seconds)
    if given.draw:
        draw(found, given.draw)
    show(found, section, as_json=given.json)
