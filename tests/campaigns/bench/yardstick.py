"""The open yardstick: laws beside ours, from the same starts, each with its best gains.

python -m tests.campaigns.bench.yardstick [--quick]

Prints one table, and writes docs/yardstick.md with its figure and docs/yardstick.json. It takes five to
eleven minutes, most of them for the predictive law.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from formation.monitor.exporters.layout import COLOURS
from tests.campaigns.bench import yardstick_trials as trials
from tests.campaigns.bench.yardstick_page import page, table
from tests.campaigns.bench.yardstick_trials import LAW, Law
from tests.campaigns.document import DOCS, stamp, update
from tests.campaigns.figures import progress, worded
from tests.campaigns.plots import PLAIN, panels

NAME = "yardstick"
BLUE, RED, GREEN, PINK, YELLOW, SKY, _ = COLOURS
MARKS = {
    "field": (BLUE, "o"),
    "paper": (RED, "s"),
    "proportional + feed-forward": (SKY, "^"),
    "Robotarium": (PINK, "D"),
    "follower": (YELLOW, "v"),
    "predictive": (GREEN, "P"),
}
LEAST_LENGTH = 0.01
"""Errors under this are shown as this [cm]."""
APART = 0.11
"""Between the marks of two laws [lines]."""


def measured(name: str, law: Law, starts: int, tuning_starts: int) -> dict[str, Any]:
    """One law, with the best of its gains, in all scenarios."""
    began = time.perf_counter()
    tried: list[dict[str, Any]] = []
    for values in itertools.product(*law.tried.values()):
        gains = dict(zip(law.tried, values, strict=True))
        found = cells(law, gains, trials.TUNED_ON, tuning_starts, trials.TUNING_SEED)
        tried.append({"gains": gains, "cost": trials.cost(found, shapeless=law.shapeless)})
    best = min(tried, key=lambda one: one["cost"])["gains"]
    progress(f"{name}: {best} after {time.perf_counter() - began:.0f} s")
    known = law.mission(trials.SCENARIOS["straight"].build(), best).gains_for(law.controller)
    found = cells(law, best, trials.SCENARIOS, starts, trials.SEED)
    progress(f"{name}: {time.perf_counter() - began:.0f} s")
    return {"gains": best, "tried": tried, "step": trials.step_times(law.controller, known), "cells": found}


def cells(law: Law, gains: Mapping[str, float], names: Any, starts: int, seed: int) -> dict[str, Any]:
    """Figures of one law in the scenarios of these `names`."""
    given = {name: trials.SCENARIOS[name] for name in names}
    return {
        name: trials.figures(*trials.edge_errors(one, law, gains, starts, seed))
        for name, one in given.items()
    }


def draw(laws: Mapping[str, Any], path: Path) -> None:
    """A line for each scenario, a mark for each law: error left, peak, and settling time."""
    style = {"svg.hashsalt": "yardstick", "font.size": 9.0}
    with panels(path, 3, (8.6, 5.4), style, sharey=True) as (rms, peak, settling):
        scenarios = list(next(iter(laws.values()))["cells"])
        for number, (name, one) in enumerate(laws.items()):
            places = [line + APART * (number - 0.5 * (len(laws) - 1)) for line in range(len(scenarios))]
            cells, (colour, mark) = list(one["cells"].values()), MARKS[name]
            for axes, key in ((rms, "rms"), (peak, "peak")):
                values = [max(100.0 * cell[key], LEAST_LENGTH) for cell in cells]
                axes.plot(values, places, mark, color=colour, markersize=4.0, label=name)
            _times(settling, cells, places, name)
        for axes, label in ((rms, "error left, RMS [cm]"), (peak, "peak in the second half [cm]")):
            axes.set(xscale="log", xlabel=label)
            axes.set_xticks((0.01, 0.1, 1.0, 10.0, 100.0), ("≤ 0.01", "0.1", "1", "10", "100"))
        settling.set(xscale="log", xlabel="settling, median to p95 [s]")
        settling.set_xticks((2.0, 5.0, 10.0, 20.0, 50.0, 100.0))
        settling.xaxis.set_major_formatter(PLAIN)
        settling.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
        rms.set_yticks(range(len(scenarios)), scenarios)
        rms.set_ylim(len(scenarios) - 0.5, -0.5)
        named = rms.get_legend_handles_labels()
        rms.figure.legend(*named, loc="outside upper center", ncols=6, frameon=False, fontsize=8.5)


def _times(axes: Axes, cells: list[Any], places: list[float], name: str) -> None:
    """Settling times, where half of the starts or more settle."""
    colour, mark = MARKS[name]
    for cell, place in zip(cells, places, strict=True):
        if cell["share"] >= 0.5:
            axes.plot([cell["median"], cell["p95"]], [place, place], color=colour, linewidth=1.2)
            axes.plot(cell["median"], place, mark, color=colour, markersize=4.0)


def main() -> None:
    """Measure, print the table, write the page."""
    parser = worded(__doc__)
    parser.add_argument("--quick", action="store_true", help="few starts, printed only: a hint")
    quick, began = parser.parse_args().quick, time.perf_counter()
    starts, tuning_starts = (4, 1) if quick else (40, 8)
    laws = {name: measured(name, one, starts, tuning_starts) for name, one in LAW.items()}
    print(table(laws))
    if quick:
        return
    one = stamp({"laws": laws}, starts, time.perf_counter() - began)
    every = update(DOCS / f"{NAME}.json", {NAME: one}, [NAME])[NAME]
    draw(every["laws"], DOCS / "figures" / f"{NAME}.svg")
    (DOCS / f"{NAME}.md").write_text(page(every), encoding="utf-8")


if __name__ == "__main__":
    main()
