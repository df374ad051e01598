"""Curves of benchmarks, as SVG: medians over rounds, from the lowest to the highest round shaded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from tests.campaigns.reliability.plots import BLUE, INK, ORANGE, STYLE

__all__ = ["BLUE", "GREEN", "INK", "ORANGE", "counted", "curve", "legend", "milliseconds", "panels"]
GREEN = "#3f9c6b"
PLAIN = FuncFormatter(lambda value, _: f"{value:g}")


@contextmanager
def panels(path: Path, count: int, height: float = 3.4) -> Iterator[Sequence[Axes]]:
    """So many panels side by side, saved at the end."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, height), layout="constrained")
        axes = figure.subplots(1, count, squeeze=False)[0]
        yield axes
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, transparent=True, metadata={"Date": None})


def curve(
    axes: Axes,
    places: Sequence[float],
    figures: Sequence[dict[str, float]],
    label: str,
    colour: str,
    line: str = "-",
) -> None:
    """One curve of figures `over_rounds`."""
    style: Any = {"color": colour, "linewidth": 1.5, "markersize": 4.0}
    axes.plot(places, [one["median"] for one in figures], f"o{line}", label=label, **style)
    low, high = ([one[end] for one in figures] for end in ("low", "high"))
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
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=columns,
        handlelength=3.0,
    )
