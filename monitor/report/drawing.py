"""Drawing of a figure's panels: arrays in, lines on axes out.

Colours are distinct for colour-blind readers (after Okabe and Ito), and lines without colour by their dashes.
With many robots colours run along the graph. Letters are 8 pt at the figures' intended size.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.plane import unit
from formation.mission.model import SimulationSpec
from formation.simulation.simulate import History
from formation.transport.runtime.command_line import needs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D1F")
DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.2)), (0, (5, 1.2, 1, 1.2)), (0, (1.6, 0.9)), (0, (8, 1.5)),
    (0, (5, 1, 1, 1, 1, 1)), (0, (3, 1)),
)  # fmt: skip
FORMATION = "#1F4E79"
INK = "#000000"
FAINT = "#707070"
MANY_ROBOTS = 40
"""Number of robots from which on they are not named one by one, and their lines are rasterised in an SVG."""
STYLE: dict[Any, Any] = {
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Helvetica", "Arial"],
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


WIDTH, HEIGHT = 7.1, 7.4
"""Size of a page with two columns [inches]; letters are 8 pt on it."""


class Look(NamedTuple):
    """Style of one robot's lines."""

    colour: Any
    dashes: Any = "-"


def looks(followers: int) -> list[Look]:
    """Return the style of every follower, in the mission's order."""
    if followers <= len(PALETTE):
        return [Look(*both) for both in zip(PALETTE, DASHES, strict=True)][:followers]
    from matplotlib import colormaps  # noqa: PLC0415 - only needed for drawing

    return [Look(tuple(colour)) for colour in colormaps["viridis"](np.linspace(0.0, 0.88, followers))]


def short(names: Sequence[str]) -> list[str]:
    """Return names short enough for a label: their numbers, if they differ only in those."""
    parts = [re.fullmatch(r"(\D*)(\d+)", name) for name in names]
    if all(parts) and len({part[1] for part in parts if part}) == 1:
        return [part[2] for part in parts if part]
    return list(names)


def graph(
    axes: Axes,
    names: Sequence[str],
    edges: Iterable[tuple[int, int]],
    points: ComplexArray,
    robots: Sequence[Look],
) -> None:
    """Draw the sensing graph at `points` [m], relative to the leader, the first of `names`."""
    if not np.isfinite(points).all():
        points = np.exp(2j * np.pi * np.arange(len(points)) / len(points))
    many, middle = len(points) > MANY_ROBOTS, complex(points.mean())
    size = 3.0 if many else 7.0
    for i, j in edges:
        arrow = {
            "arrowstyle": "-|>",
            "color": FAINT,
            "linewidth": 0.7,
            "shrinkA": size / 2,
            "shrinkB": size / 2,
        }
        axes.annotate("", xy(points[j]), xy(points[i]), arrowprops=arrow)
    for i, point in enumerate(points):
        colour = INK if i == 0 else robots[i - 1].colour
        axes.plot(point.real, point.imag, "o", color=colour, markersize=size, zorder=3)
        if not many:
            out = unit(point - middle, 1j)
            axes.annotate(
                names[i], xy(point), xytext=(9.0 * out.real, 9.0 * out.imag), textcoords="offset points",
                ha=("left", "center", "right")[1 - round(out.real)], va="center", fontsize=7, zorder=4,
            )  # fmt: skip
    axes.set(xlabel="$x$ from the leader [m]", ylabel="$y$ from the leader [m]")
    equal(axes, 0.2)


def draw_paths(axes: Axes, centres: ComplexArray, names: Sequence[str], robots: Sequence[Look]) -> None:
    """Draw the centres' paths [m; world frame], shape (T, N), the leader's dotted; a number at each start."""
    many = len(names) > MANY_ROBOTS
    axes.plot(centres[:, 0].real, centres[:, 0].imag, color=INK, linewidth=0.9, linestyle=":")
    for path, look in zip(centres.T[1:], robots, strict=True):
        axes.plot(
            path.real, path.imag, color=look.colour, linestyle=look.dashes, linewidth=0.8, rasterized=many
        )
    for path, name, colour in zip(
        centres.T, short(names), [INK, *(look.colour for look in robots)], strict=True
    ):
        known = path[np.isfinite(path)]
        if known.size and not many:
            axes.plot(known[0].real, known[0].imag, "o", color=colour, markersize=2.2)
            axes.annotate(
                name, xy(known[0]), xytext=(-3, 3), textcoords="offset points", ha="right", fontsize=7,
                color=colour,
            )  # fmt: skip
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    equal(axes)


def formations(axes: Axes, points: ComplexArray, edges: Iterable[tuple[int, int]]) -> None:
    """Draw the formation of control points [m; world frame] at M moments, shape (M, N): the first grey."""
    edges = list(edges)
    for number, marks in enumerate(points):
        first, strength = number == 0, 0.35 + 0.65 * number / max(len(points) - 1, 1)
        line: dict[str, Any] = {
            "color": "#9A9A9A" if first else FORMATION,
            "alpha": 1.0 if first else strength,
        }
        for i, j in edges:
            ends = marks[[i, j]]
            axes.plot(ends.real, ends.imag, linewidth=0.6 if first else 0.9, **line)
        axes.plot(marks.real, marks.imag, "o", markersize=2.0, **line)


def things(axes: Axes, world: SimulationSpec) -> None:
    """Draw posts and walls of a simulated world."""
    from matplotlib.patches import Circle  # noqa: PLC0415

    for post in world.posts:
        axes.add_patch(Circle((post.x, post.y), post.radius, color=FAINT, linewidth=0.0))
    for wall in world.walls:
        axes.plot(*zip(wall.begin, wall.end, strict=True), color=FAINT, linewidth=1.6)


def moments(times: Iterable[float]) -> str:
    """Return a few moments [s] as words for a title."""
    return ", ".join(f"{time:.0f}" if time >= 99.95 else f"{round(time, 1):g}" for time in times) + " s"


def limits(axes: Axes, values: FloatArray) -> None:
    """Draw dashed lines at ± each of `values`, and make room for them."""
    for limit in np.unique(values):
        for sign in (-1.0, 1.0):
            axes.axhline(sign * limit, color="#606060", linewidth=0.8, linestyle="--", zorder=1.8)
    axes.set_ylim(-1.12 * values.max(), 1.12 * values.max())


def falling(axes: Axes, least: float, most: float) -> None:
    """Set a logarithmic scale for an error [m] from `most` down to `least`, within bounds."""
    axes.set_yscale("log")
    if 0.0 < most < np.inf:
        axes.set_ylim(max(least, 1e-6 * most, 1e-5) / 2.0, 2.0 * most)


def span(time: FloatArray, error: FloatArray) -> float:
    """Return the end of a run's interesting part [s]: well after the error last left 1 % of its peak.

    It is at most the last moment at which the error was known.
    """
    known = np.flatnonzero(np.isfinite(error))
    if not known.size:
        return float(time[-1]) if time.size else 0.0
    time, error = time[: known[-1] + 1], error[: known[-1] + 1]
    big = np.flatnonzero(np.nan_to_num(error, nan=np.inf) > 0.01 * np.nanmax(error[np.isfinite(error)]))
    last = time[big[-1]] if big.size else time[0]
    return float(np.clip(np.ceil(2.0 * last), min(5.0, time[-1]), time[-1]))


def equal(axes: Axes, margin: float = 0.08) -> None:
    """Set equal scales in x and y, with room for marks and words at the border."""
    axes.set_aspect("equal", adjustable="datalim")
    box = axes.dataLim
    if np.isfinite(box.extents).all():
        axes.update_datalim(box.padded(margin * max(box.width, box.height)).get_points())
    axes.margins(0.0)
    axes.autoscale_view()


def unjoined(angles: FloatArray) -> FloatArray:
    """Return angles with a gap where they wrap around, so that no line is drawn across."""
    apart = angles.copy()
    apart[1:][np.abs(np.diff(angles, axis=0)) > np.pi] = np.nan
    return apart


def legend(names: Sequence[str], robots: Sequence[Look]) -> list[Any]:
    """Return legend handles of the leader and the followers; of many, a few."""
    from matplotlib.lines import Line2D  # noqa: PLC0415

    chosen = range(len(robots)) if len(robots) <= 14 else (0, len(robots) // 2, len(robots) - 1)
    handles: list[Any] = [Line2D([], [], color=INK, linestyle=":", label=names[0])]
    handles += [
        Line2D([], [], color=robots[i].colour, linestyle=robots[i].dashes, label=names[i + 1]) for i in chosen
    ]
    return [*handles, Line2D([], [], color="#606060", linestyle="--", linewidth=0.8, label="limits")]


def xy(point: complex) -> tuple[float, float]:
    """Return a point's coordinates for matplotlib."""
    return float(point.real), float(point.imag)


def draw(history: History, path: Path | str, until: float | None = None) -> None:
    """Write the panels of the paper's Fig. 2 of a simulation, in the format of `path`'s suffix.

    `until` [s] is the last moment shown; by default until the formation has formed. Raises
    ModuleNotFoundError without matplotlib, OSError if the file cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - only needed for drawing
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ModuleNotFoundError as missing:
        text = f"a figure {needs('matplotlib')}"
        raise ModuleNotFoundError(text, name=missing.name) from None
    last = span(history.time, history.error) if until is None else until
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        _panels(figure, history, history.time <= last + 1e-9)
        figure.savefig(path, dpi=200)


def _panels(figure: Figure, history: History, shown: Any) -> None:
    grid: Any = figure.subplots(3, 2, height_ratios=(1.35, 1.0, 1.0))
    layout, tracks, angles, errors, speeds, turn_rates = grid.flat
    robots, time, points = looks(len(history.names) - 1), history.time[shown], history.points[shown]
    graph(layout, history.names, history.edges, history.points[-1] - history.points[-1, 0], robots)
    layout.set(title="(a) Measurement graph")
    four = np.linspace(0, len(points) - 1, 4).astype(int)
    draw_paths(tracks, history.position[shown], history.names, robots)
    formations(tracks, points[four], history.edges)
    tracks.set(title=f"(b) Trajectories; formation at {moments(time[four])}")
    _over_time(angles, time, np.rad2deg(unjoined(history.heading_error[shown])), robots)
    angles.set(title="(c) Heading errors", ylabel="estimate less truth [°]", ylim=(-190.0, 190.0))
    angles.set_yticks([-180, -90, 0, 90, 180])
    positive = np.where(history.error[shown] > 0.0, history.error[shown], np.nan)
    errors.plot(time, positive, color="black")
    if (finite := positive[np.isfinite(positive)]).size:
        falling(errors, float(finite.min()), float(finite.max()))
    errors.set(title="(d) Formation error", ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]")
    _over_time(speeds, time, history.speed[shown], robots)
    limits(speeds, history.max_speed)
    leader = np.abs(np.gradient(history.position[:, 0], history.time))[shown]
    speeds.plot(time, leader, color="black", linewidth=0.8, linestyle=":")
    speeds.set(title="(e) Forward speeds (leader dotted)", ylabel="$u$ [m/s]")
    _over_time(turn_rates, time, history.turn_rate[shown], robots)
    limits(turn_rates, history.max_turn_rate)
    turn_rates.set(title="(f) Turn rates", ylabel="$\\omega$ [rad/s]")
    for axes in (angles, errors, speeds, turn_rates):
        axes.set(xlabel="time [s]", xlim=(time[0], time[-1]))
    handles = legend(history.names, robots)
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 7), handlelength=2.2)
    figure.suptitle(history.title, fontsize=9)


def _over_time(axes: Axes, time: FloatArray, values: FloatArray, robots: Sequence[Look]) -> None:
    for column, look in zip(values.T, robots, strict=True):
        axes.plot(time, column, color=look.colour, linestyle=look.dashes)
