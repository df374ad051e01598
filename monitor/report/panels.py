"""The panels of the paper's Fig. 2 from one run: graph, trajectories, heading errors, formation error, u, ω.

Pure except for writing the file. matplotlib is imported only for drawing: robots do not have it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from formation.control.arrays import FloatArray
from formation.monitor.report import drawing
from formation.monitor.report.drawing import STYLE, Look
from formation.simulation.simulate import History
from formation.transport.runtime.command_line import needs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 7.1, 7.4
"""Size of a page with two columns [inches]; letters are 8 pt on it."""


def draw(history: History, path: Path | str, until: float | None = None) -> None:
    """Write the figure in the format of `path`'s suffix (.png, .svg, .pdf).

    `until` [s] is the last moment shown; by default until the formation has formed. Raises
    ModuleNotFoundError without matplotlib, OSError if the file cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - only needed for drawing
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ModuleNotFoundError as missing:
        text = f"a figure {needs('matplotlib')}"
        raise ModuleNotFoundError(text, name=missing.name) from None
    last = drawing.span(history.time, history.error) if until is None else until
    shown = history.time <= last + 1e-9
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        _panels(figure, history, shown)
        figure.savefig(path, dpi=200)


def _panels(figure: Figure, history: History, shown: Any) -> None:
    grid: Any = figure.subplots(3, 2, height_ratios=(1.35, 1.0, 1.0))
    looks = drawing.looks(len(history.names) - 1)
    time = history.time[shown]
    drawing.graph(grid[0, 0], history.names, history.edges, history.points[-1] - history.points[-1, 0], looks)
    grid[0, 0].set(title="(a) Measurement graph")
    _trajectories(grid[0, 1], history, shown, looks)
    _over_time(grid[1, 0], time, np.rad2deg(drawing.unjoined(history.heading_error[shown])), looks)
    grid[1, 0].set(title="(c) Heading errors", ylabel="estimate less truth [°]", ylim=(-190.0, 190.0))
    grid[1, 0].set_yticks([-180, -90, 0, 90, 180])
    _error(grid[1, 1], time, history.error[shown])
    _over_time(grid[2, 0], time, history.speed[shown], looks)
    drawing.limits(grid[2, 0], history.max_speed)
    leader = np.abs(np.gradient(history.position[:, 0], history.time))[shown]
    grid[2, 0].plot(time, leader, color="black", linewidth=0.8, linestyle=":")
    grid[2, 0].set(title="(e) Forward speeds (leader dotted)", ylabel="$u$ [m/s]")
    _over_time(grid[2, 1], time, history.turn_rate[shown], looks)
    drawing.limits(grid[2, 1], history.max_turn_rate)
    grid[2, 1].set(title="(f) Turn rates", ylabel="$\\omega$ [rad/s]")
    for axes in grid[1:].flat:
        axes.set(xlabel="time [s]", xlim=(time[0], time[-1]))
    handles = drawing.legend(history.names, looks)
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 7), handlelength=2.2)
    figure.suptitle(history.title, fontsize=9)


def _trajectories(axes: Axes, history: History, shown: Any, looks: list[Look]) -> None:
    """Draw the centres' paths, and the formation of control points at four moments."""
    points = history.points[shown]
    moments = np.linspace(0, len(points) - 1, 4).astype(int)
    drawing.draw_paths(axes, history.position[shown], history.names, looks)
    drawing.formations(axes, points[moments], history.edges)
    axes.set(title=f"(b) Trajectories; formation at {drawing.moments(history.time[shown][moments])}")


def _error(axes: Axes, time: FloatArray, error: FloatArray) -> None:
    positive = np.where(error > 0.0, error, np.nan)
    axes.plot(time, positive, color="black")
    finite = positive[np.isfinite(positive)]
    if finite.size:
        drawing.falling(axes, float(finite.min()), float(finite.max()))
    axes.set(title="(d) Formation error", ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]")


def _over_time(axes: Axes, time: FloatArray, values: FloatArray, looks: list[Look]) -> None:
    for column, look in zip(values.T, looks, strict=True):
        axes.plot(time, column, color=look.colour, linestyle=look.dashes)
