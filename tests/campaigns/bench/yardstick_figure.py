"""The figure of the yardstick: a line for each scenario, a mark for each law."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from formation.monitor.exporters.layout import COLOURS
from tests.campaigns.plots import PLAIN, STYLE

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


def draw(laws: Mapping[str, Any], path: Path) -> None:
    """Error left, peak, and settling time, into `path`."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": "yardstick", "font.size": 9.0}):
        figure = Figure(figsize=(8.6, 5.4), layout="constrained")
        rms, peak, settling = figure.subplots(1, 3, sharey=True)
        scenarios = list(next(iter(laws.values()))["cells"])
        for number, (name, one) in enumerate(laws.items()):
            places = [line + APART * (number - 0.5 * (len(laws) - 1)) for line in range(len(scenarios))]
            cells = list(one["cells"].values())
            for axes, key in ((rms, "rms"), (peak, "peak")):
                _marks(axes, [max(100.0 * cell[key], LEAST_LENGTH) for cell in cells], places, name)
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
        handles, labels = rms.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=6, frameon=False, fontsize=8.5)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, transparent=True, metadata={"Date": None})


def _marks(axes: Axes, values: list[float], places: list[float], name: str) -> None:
    colour, mark = MARKS[name]
    axes.plot(values, places, mark, color=colour, markersize=4.0, label=name)


def _times(axes: Axes, cells: list[Any], places: list[float], name: str) -> None:
    """Settling times, where half of the starts or more settle."""
    colour, mark = MARKS[name]
    for cell, place in zip(cells, places, strict=True):
        if cell["share"] >= 0.5:
            axes.plot([cell["median"], cell["p95"]], [place, place], color=colour, linewidth=1.2)
            axes.plot(cell["median"], place, mark, color=colour, markersize=4.0)
