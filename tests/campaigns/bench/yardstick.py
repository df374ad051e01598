"""The open yardstick: laws beside ours, from the same starts, each with its best gains.

python -m tests.campaigns.bench.yardstick [--quick | --page]

Prints one table, and writes docs/yardstick.md with its figure and docs/yardstick.json. It takes five to
eleven minutes, most of them for the predictive law.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from tests.campaigns.bench.yardstick_figure import draw
from tests.campaigns.bench.yardstick_page import page, table
from tests.campaigns.bench.yardstick_trials import (
    LAW,
    SCENARIOS,
    SEED,
    TUNED_ON,
    TUNING_SEED,
    Law,
    cost,
    edge_errors,
    figures,
    step_times,
)
from tests.campaigns.document import DOCS, stamp, update
from tests.campaigns.figures import progress

NAME = "yardstick"


class Effort(NamedTuple):
    """How much to run."""

    starts: int = 40
    tuning_starts: int = 8


QUICK = Effort(4, 1)


def measure(effort: Effort) -> dict[str, Any]:
    """All laws: {law: {gains, tried, step [µs], cells: {scenario: figures}}}."""
    return {name: measured(name, one, effort) for name, one in LAW.items()}


def measured(name: str, law: Law, effort: Effort) -> dict[str, Any]:
    """One law, with the best of its gains, in all scenarios."""
    began = time.perf_counter()
    tried = []
    for gains in combinations(law.tried):
        found = cells(law, gains, TUNED_ON, effort.tuning_starts, TUNING_SEED)
        tried.append((cost(found, shapeless=law.shapeless), gains))
    best = min(tried, key=lambda one: one[0])[1]
    progress(f"{name}: {best} after {time.perf_counter() - began:.0f} s")
    known = law.mission(SCENARIOS["straight"].build(), best).gains_for(law.controller)
    found = cells(law, best, SCENARIOS, effort.starts, SEED)
    progress(f"{name}: {time.perf_counter() - began:.0f} s")
    return {
        "gains": best,
        "tried": [{"gains": gains, "cost": value} for value, gains in tried],
        "step": step_times(law.controller, known),
        "cells": found,
    }


def combinations(tried: Mapping[str, tuple[float, ...]]) -> Iterator[dict[str, float]]:
    """Every combination of the values of all keys."""
    for values in itertools.product(*tried.values()):
        yield dict(zip(tried, values, strict=True))


def cells(law: Law, gains: Mapping[str, float], names: Any, starts: int, seed: int) -> dict[str, Any]:
    """Figures of one law in the scenarios of these `names`."""
    return {name: figures(*edge_errors(SCENARIOS[name], law, gains, starts, seed)) for name in names}


def main() -> None:
    """Measure, print the table, write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few starts, printed only: a hint")
    parser.add_argument("--page", action="store_true", help="the page anew, from the figures that are there")
    given = parser.parse_args()
    effort, began = QUICK if given.quick else Effort(), time.perf_counter()
    found = {} if given.page else measure(effort)
    if given.quick:
        print(table(found))
        return
    one = {} if given.page else {NAME: stamp({"laws": found}, effort.starts, time.perf_counter() - began)}
    every = update(DOCS / f"{NAME}.json", one, [NAME])[NAME]
    draw(every["laws"], DOCS / "figures" / f"{NAME}.svg")
    (DOCS / f"{NAME}.md").write_text(page(every), encoding="utf-8")
    print(table(every["laws"]))


if __name__ == "__main__":
    main()
