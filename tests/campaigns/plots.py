"""Pictures for docs/figures: SVG on no ground and in middle tones, to be read on white and on black alike."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from tests.campaigns.figures import at

INK, FAINT = "#808080", "#80808040"
BLUE, ORANGE, GREEN = "#2f87d6", "#d9722e", "#3f9c6b"
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "reliability",
    "font.size": 10,
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
    "grid.color": FAINT,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
PLAIN = FuncFormatter(lambda value, _: f"{value:g}")


@contextmanager
def panels(
    path: Path, count: int, size: tuple[float, float] = (8.0, 3.4), style: Any = STYLE, **options: Any
) -> Iterator[Sequence[Axes]]:
    """So many panels side by side, as `Figure.subplots` makes them, saved at the end."""
    with mpl.rc_context({**STYLE, **style}):
        figure = Figure(figsize=size, layout="constrained")
        yield figure.subplots(1, count, squeeze=False, **options)[0]
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, transparent=True, metadata={"Date": None})


def curve(
    axes: Axes,
    places: Sequence[float],
    rows: Iterable[Any],
    path: str,
    label: str,
    colour: str,
    line: str = "-",
) -> None:
    """One curve of the figures `over_rounds` at a path of each row, from lowest to highest round shaded."""
    middle, low, high = ([at(row, path)[key] for row in rows] for key in ("median", "low", "high"))
    axes.plot(places, middle, f"o{line}", label=label, color=colour, linewidth=1.5, markersize=4.0)
    axes.fill_between(places, low, high, color=colour, alpha=0.15, linewidth=0.0)


def counted(axes: Axes, places: Sequence[float], label: str) -> None:
    """A logarithmic axis with these places marked, and no others."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(list(places)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(PLAIN)
    axes.set_xlabel(label)


def milliseconds(axes: Axes, label: str) -> None:
    """A logarithmic axis upwards."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PLAIN)
    axes.set_ylabel(label)


def legend(axes: Axes, columns: int) -> None:
    """What is what, above the panel, where no curve is."""
    axes.legend(
        frameon=False,
        fontsize=8,
        ncols=columns,
        handlelength=3.0,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
    )
