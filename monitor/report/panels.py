"""The panels of the paper's Fig. 2 from one run: graph, trajectories, heading errors, formation error, u, ω.

Pure but for the file that it writes. matplotlib is imported when a figure is drawn: a robot does not have it.
Colours can be told apart by the colour-blind (after Okabe and Ito); with many robots they run along the
graph.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from formation.plane import FloatArray
from formation.simulation.history import History

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 7.1, 7.4
"""Of a page with two columns [inches]; letters are 8 pt on it."""
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D1F")
FORMATION = "#1F4E79"
STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}


def draw(history: History, path: Path | str, until: float | None = None) -> None:
    """Write the figure; the suffix of `path` (.png, .svg, .pdf) says how.

    `until` [s] is the last moment shown; by default what it takes to see the formation form. Raises
    ModuleNotFoundError without matplotlib, OSError where the file cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - only who draws needs it
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ModuleNotFoundError as missing:
        text = "a figure needs matplotlib: pip install 'formation[plot]'"
        raise ModuleNotFoundError(text, name=missing.name) from None
    shown = history.time <= (_span(history) if until is None else until) + 1e-9
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        _panels(figure, history, shown)
        figure.savefig(path, dpi=200)


def _panels(figure: Figure, history: History, shown: Any) -> None:
    grid: Any = figure.subplots(3, 2, height_ratios=(1.35, 1.0, 1.0))
    colours = _colours(len(history.names) - 1)
    time = history.time[shown]
    _graph(grid[0, 0], history, colours)
    _trajectories(grid[0, 1], history, shown, colours)
    _over_time(grid[1, 0], time, np.rad2deg(_unjoined(history.heading_error[shown])), colours)
    grid[1, 0].set(title="(c) Heading errors", ylabel="estimate less truth [°]", ylim=(-190.0, 190.0))
    grid[1, 0].set_yticks([-180, -90, 0, 90, 180])
    _error(grid[1, 1], time, history.error[shown])
    _over_time(grid[2, 0], time, history.speed[shown], colours)
    _limits(grid[2, 0], history.max_speed)
    leader = np.abs(np.gradient(history.position[:, 0], history.time))[shown]
    grid[2, 0].plot(time, leader, color="black", linewidth=0.8, linestyle=":")
    grid[2, 0].set(title="(e) Forward speeds (leader dotted)", ylabel="$u$ [m/s]")
    _over_time(grid[2, 1], time, history.turn_rate[shown], colours)
    _limits(grid[2, 1], history.max_turn_rate)
    grid[2, 1].set(title="(f) Turn rates", ylabel="$\\omega$ [rad/s]")
    for axes in grid[1:].flat:
        axes.set(xlabel="time [s]", xlim=(time[0], time[-1]))
    _legend(figure, history, colours)


def _span(history: History) -> float:
    """Until when the run is worth looking at [s]: well after the error last left one per cent of its peak."""
    error = np.nan_to_num(history.error, nan=np.inf)
    finite = error[np.isfinite(error)]
    if not finite.size:
        return float(history.time[-1])
    last = history.time[np.flatnonzero(error > 0.01 * finite.max())[-1]]
    return float(np.clip(np.ceil(2.0 * last), min(5.0, history.time[-1]), history.time[-1]))


def _colours(followers: int) -> list[Any]:
    if followers <= len(PALETTE):
        return list(PALETTE[:followers])
    from matplotlib import colormaps  # noqa: PLC0415

    return list(colormaps["viridis"](np.linspace(0.0, 0.88, followers)))


def _graph(axes: Axes, history: History, colours: list[Any]) -> None:
    """Who measures whom, drawn where the formation stands in the end."""
    points = history.points[-1] - history.points[-1, 0]
    if not np.isfinite(points).all():
        points = np.exp(2j * np.pi * np.arange(len(points)) / len(points))
    many = len(points) > 40
    size = 3.0 if many else 7.0
    for i, j in history.edges:
        arrow = {
            "arrowstyle": "-|>",
            "color": "#707070",
            "linewidth": 0.7,
            "shrinkA": size / 2,
            "shrinkB": size / 2,
        }
        axes.annotate("", _xy(points[j]), _xy(points[i]), arrowprops=arrow)
    for i, point in enumerate(points):
        colour = "black" if i == 0 else colours[i - 1]
        axes.plot(point.real, point.imag, "o", color=colour, markersize=size, zorder=3)
        if not many:
            beside: dict[str, Any] = {
                "textcoords": "offset points",
                "xytext": (0.0, 6.0),
                "ha": "center",
                "fontsize": 7,
            }
            axes.annotate(history.names[i], _xy(point), zorder=4, **beside)
    axes.set(
        title="(a) Who measures whom", xlabel="$x$ from the leader [m]", ylabel="$y$ from the leader [m]"
    )
    _equal(axes, 0.18)


def _trajectories(axes: Axes, history: History, shown: Any, colours: list[Any]) -> None:
    """Ways of the centres, and the formation of control points at four moments."""
    position, points = history.position[shown], history.points[shown]
    axes.plot(position[:, 0].real, position[:, 0].imag, color="black", linewidth=0.9, linestyle=":")
    for i, colour in enumerate(colours, start=1):
        axes.plot(position[:, i].real, position[:, i].imag, color=colour, linewidth=0.8)
    moments = np.linspace(0, len(points) - 1, 4).astype(int)
    for number, moment in enumerate(moments):
        first, strength = number == 0, 0.35 + 0.65 * number / 3.0
        line: dict[str, Any] = {
            "color": "#9A9A9A" if first else FORMATION,
            "alpha": 1.0 if first else strength,
        }
        for i, j in history.edges:
            ends = points[moment, [i, j]]
            axes.plot(ends.real, ends.imag, linewidth=0.6 if first else 0.9, **line)
        marks = points[moment]
        axes.plot(marks.real, marks.imag, "o", markersize=2.0, **line)
    seconds = ", ".join(f"{history.time[shown][moment]:.3g}" for moment in moments)
    axes.set(title=f"(b) Trajectories; formation at {seconds} s", xlabel="$x$ [m]", ylabel="$y$ [m]")
    _equal(axes)


def _error(axes: Axes, time: FloatArray, error: FloatArray) -> None:
    positive = np.where(error > 0.0, error, np.nan)
    axes.semilogy(time, positive, color="black")
    finite = positive[np.isfinite(positive)]
    if finite.size:
        axes.set_ylim(max(finite.min(), 1e-6 * finite.max(), 1e-5) / 2.0, 2.0 * finite.max())
    axes.set(title="(d) Formation error", ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]")


def _over_time(axes: Axes, time: FloatArray, values: FloatArray, colours: list[Any]) -> None:
    for column, colour in zip(values.T, colours, strict=True):
        axes.plot(time, column, color=colour)


def _limits(axes: Axes, limits: FloatArray) -> None:
    for limit in np.unique(limits):
        for sign in (-1.0, 1.0):
            axes.axhline(sign * limit, color="#606060", linewidth=0.8, linestyle="--", zorder=1)
    axes.set_ylim(-1.12 * limits.max(), 1.12 * limits.max())


def _legend(figure: Figure, history: History, colours: list[Any]) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415

    few = len(colours) <= 14
    chosen = range(len(colours)) if few else (0, len(colours) // 2, len(colours) - 1)
    handles = [Line2D([], [], color="black", linestyle=":", label=history.names[0])]
    handles += [Line2D([], [], color=colours[i], label=history.names[i + 1]) for i in chosen]
    handles.append(Line2D([], [], color="#606060", linestyle="--", linewidth=0.8, label="limits"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 7), handlelength=1.6)
    figure.suptitle(history.title, fontsize=9)


def _unjoined(angles: FloatArray) -> FloatArray:
    """Angles with a gap where they wrap around, so that no line is drawn across."""
    apart = angles.copy()
    apart[1:][np.abs(np.diff(angles, axis=0)) > np.pi] = np.nan
    return apart


def _equal(axes: Axes, margin: float = 0.08) -> None:
    """One metre is as long in x as in y, with room for marks at the border."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(margin)


def _xy(point: complex) -> tuple[float, float]:
    return float(point.real), float(point.imag)
