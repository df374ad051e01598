"""Figures for docs/figures: SVG on no ground and in middle tones, to be read on white and on black alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

INK, FAINT = "#808080", "#80808040"
BLUE, ORANGE = "#2f87d6", "#d9722e"
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "reliability",
    "font.size": 10,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": FAINT,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
NEAR_MM = 20.0
BEFORE, AFTER = -0.5, 6.0
"""Of a takeover, what is shown [s]."""


FIGURES = "figures"
"""Folder beside the document."""
TAKEOVERS, CONDITIONS = f"{FIGURES}/reliability_takeover.svg", f"{FIGURES}/reliability_network.svg"


def draw(name: str, found: Mapping[str, Any], docs: Path) -> None:
    """The figure of a part, if it has one."""
    if name == "failover":
        takeovers(found["curves"], docs / TAKEOVERS)
    elif name == "network":
        conditions(found["cells"], docs / CONDITIONS)


def takeovers(curves: Sequence[Sequence[Sequence[float]]], path: Path) -> None:
    """Formation error over time since the leader's death, of every try. `curves` are of pairs [s, m]."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.0), layout="constrained")
        axes = figure.subplots()
        for curve in curves:
            shown = np.array([pair for pair in curve if BEFORE <= pair[0] <= AFTER])
            if len(shown):
                axes.plot(shown[:, 0], 1000.0 * shown[:, 1], color=BLUE, alpha=0.5, linewidth=1.0)
        axes.axhline(NEAR_MM, color=ORANGE, linewidth=1.0, linestyle="--")
        axes.axvline(0.0, color=INK, linewidth=1.0)
        axes.set_xlabel("since the leader was killed [s]")
        axes.set_ylabel("formation error [mm]")
        axes.set_xlim(BEFORE, AFTER)
        axes.set_ylim(bottom=0.0)
        _save(figure, path)


def conditions(cells: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Settled error of every condition, median and worst, and the time that it took to converge."""
    names = [_words(cell) for cell in cells.values()]
    places = np.arange(len(names))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.4), layout="constrained")
        error, time = figure.subplots(1, 2, sharey=True)
        for axes, key, scale, label in (
            (error, "settled", 1000.0, "settled error [mm]"),
            (time, "converges", 1.0, "converges in [s]"),
        ):
            for place, cell in zip(places, cells.values(), strict=True):
                if (found := cell[key]) is None:
                    axes.text(0.0, place, " never", color=ORANGE, verticalalignment="center")
                    continue
                middle, worst = scale * found["median"], scale * found["worst"]
                axes.plot([middle, worst], [place, place], color=BLUE, alpha=0.5, linewidth=2.0)
                axes.plot([middle], [place], "o", color=BLUE, markersize=5.0)
            axes.set_xlabel(label)
            axes.set_xlim(left=0.0)
        error.set_xscale("symlog", linthresh=1.0)
        error.axvline(NEAR_MM, color=ORANGE, linewidth=1.0, linestyle="--")
        error.set_yticks(places, names)
        error.invert_yaxis()
        _save(figure, path)


def _words(cell: Mapping[str, Any]) -> str:
    parts = [f"{100 * cell['loss']:g} % lost"] if cell["loss"] else []
    parts += [f"{1000 * cell['delay']:g} ms"] if cell["delay"] else []
    return ("TCP: " if cell.get("shipped") else "") + (", ".join(parts) or "as it is")


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, transparent=True, metadata={"Date": None})
