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
from numpy.typing import NDArray

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.plane import unit
from formation.mission.model import SimulationSpec
from formation.monitor.exporters.layout import COLOURS as PALETTE
from formation.simulation.simulate import History
from formation.transport.runtime.command_line import needs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
WIDTH, HEIGHT = 7.1, 8.8
"""Size of a page with two columns [inches]; letters are 8 pt on it."""
SNAPSHOTS = 5
"""Number of formations side by side."""
SNAPSHOT_GAP = 0.25
"""Between the two widest [share of their width]."""
CHATTER_TIME, MIN_CHATTER_SAMPLES, MAX_CHATTER_SAMPLES = 0.4, 9, 200
"""Window in which a line is examined for chatter [s], its least and its greatest length [samples]."""
CHATTER_TURNS, CHATTER_SHARE = 3.0, 0.04
"""A line chatters where it goes up and down by so many times its range within the window [–], a range that is
more than this share of that of all lines [–]."""
LABEL_DIRECTIONS = 24
"""Number of directions in which there may be room for a label."""


class LineStyle(NamedTuple):
    """Style of one robot's lines."""

    colour: Any
    dashes: Any = "-"


def line_styles(followers: int) -> list[LineStyle]:
    """Return the style of every follower, in the mission's order."""
    if followers <= len(PALETTE):
        return [LineStyle(*both) for both in zip(PALETTE, DASHES, strict=True)][:followers]
    from matplotlib import colormaps  # noqa: PLC0415 - only needed for drawing

    return [LineStyle(tuple(colour)) for colour in colormaps["viridis"](np.linspace(0.0, 0.88, followers))]


def short_names(names: Sequence[str]) -> list[str]:
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
    robots: Sequence[LineStyle],
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
    equal_scales(axes, 0.2)


def draw_paths(
    axes: Axes,
    centres: ComplexArray,
    names: Sequence[str],
    robots: Sequence[LineStyle],
    lines: ComplexArray,
) -> None:
    """Draw the centres' paths [m; world frame], shape (T, N), the leader's dotted; a number at each start.

    Numbers are where there is most room between the paths and the points of other `lines` [m; world frame].
    """
    many = len(names) > MANY_ROBOTS
    axes.plot(centres[:, 0].real, centres[:, 0].imag, color=INK, linewidth=0.9, linestyle=":")
    for path, style in zip(centres.T[1:], robots, strict=True):
        axes.plot(
            path.real, path.imag, color=style.colour, linestyle=style.dashes, linewidth=0.8, rasterized=many
        )
    if not many:
        drawn = np.concatenate([centres[:: max(1, len(centres) // 500)].ravel(), lines])
        _label_starts(axes, centres, names, [INK, *(style.colour for style in robots)], drawn)
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    equal_scales(axes)


def _label_starts(
    axes: Axes, centres: ComplexArray, names: Sequence[str], colours: Sequence[Any], drawn: ComplexArray
) -> None:
    drawn = drawn[np.isfinite(drawn)]
    for path, name, colour in zip(centres.T, short_names(names), colours, strict=True):
        known = path[np.isfinite(path)]
        if known.size:
            out = roomiest(complex(known[0]), drawn)
            axes.plot(known[0].real, known[0].imag, "o", color=colour, markersize=2.2)
            axes.annotate(
                name, xy(known[0]), xytext=(6.5 * out.real, 6.5 * out.imag), textcoords="offset points",
                ha="center", va="center", fontsize=7, color=colour, zorder=4,
            )  # fmt: skip


def roomiest(point: complex, drawn: ComplexArray) -> complex:
    """Return the direction from `point`, of unit length, in which the `drawn` points are furthest away."""
    size = max(float(np.ptp(drawn.real)), float(np.ptp(drawn.imag)), 1e-9)
    near = drawn[np.abs(drawn - point) < 0.2 * size]
    directions = np.exp(2j * np.pi * (np.arange(LABEL_DIRECTIONS) / LABEL_DIRECTIONS + 3 / 8))
    if not near.size:
        return complex(directions[0])
    room = np.abs(point + 0.05 * size * directions[:, None] - near).min(axis=1)
    return complex(directions[room.argmax()])


def along_edges(points: ComplexArray, edges: Iterable[tuple[int, int]]) -> ComplexArray:
    """Return points along the edges of one formation [m], shape (N,)."""
    shares = np.linspace(0.0, 1.0, 30)
    parts = [points[i] + shares * (points[j] - points[i]) for i, j in edges]
    return np.concatenate([np.empty(0, dtype=np.complex128), *parts])


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


def snapshots(
    axes: Axes,
    time: FloatArray,
    points: ComplexArray,
    edges: Iterable[tuple[int, int]],
    robots: Sequence[LineStyle],
) -> None:
    """Draw the formation of control points [m; world frame] at M moments [s], side by side at one scale.

    `points` has the shape (M, N), the leader first.
    """
    edges, size = list(edges), 3.0 if points.shape[1] > MANY_ROBOTS else 4.5
    low = points.real.min(axis=1) + 1j * points.imag.min(axis=1)
    high = points.real.max(axis=1) + 1j * points.imag.max(axis=1)
    apart = (1.0 + SNAPSHOT_GAP) * float((high - low).real.max())
    top = 0.5 * float((high - low).imag.max())
    for number, words in enumerate(time):
        marks = number * apart + points[number] - 0.5 * (low[number] + high[number])
        for i, j in edges:
            axes.plot(marks[[i, j]].real, marks[[i, j]].imag, color=FAINT, linewidth=0.7, zorder=1.5)
        colours = [INK, *(style.colour for style in robots)]
        axes.scatter(marks.real, marks.imag, s=size**2, c=colours, linewidths=0.0, zorder=3)
        axes.annotate(
            moments([words]), (number * apart, -top), xytext=(0.0, -6.0), textcoords="offset points",
            ha="center", va="top", fontsize=7,
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    left = -0.5 * apart
    axes.plot([left, left + 1.0], [top, top], color=INK, linewidth=1.0, solid_capstyle="butt")
    axes.annotate("1 m", (left + 0.5, top), xytext=(0, -3), textcoords="offset points", ha="center", va="top",
                  fontsize=7)  # fmt: skip


def draw_obstacles(axes: Axes, world: SimulationSpec) -> None:
    """Draw posts and walls of a simulated world."""
    from matplotlib.patches import Circle  # noqa: PLC0415

    for post in world.posts:
        axes.add_patch(Circle((post.x, post.y), post.radius, color=FAINT, linewidth=0.0))
    for wall in world.walls:
        axes.plot(*zip(wall.begin, wall.end, strict=True), color=FAINT, linewidth=1.6)


def separate_formations(points: ComplexArray) -> NDArray[np.intp]:
    """Return the indices of the formations to draw in one panel, of `points` [m] at M moments, shape (M, N).

    The first and the last, and others with bounding boxes that overlap none of those drawn.
    """
    low = points.real.min(axis=1) + 1j * points.imag.min(axis=1)
    high = points.real.max(axis=1) + 1j * points.imag.max(axis=1)
    chosen = [0, len(points) - 1]
    for one in range(len(points) - 2, 0, -1):
        below, above = low[one] - high[chosen], low[chosen] - high[one]
        if (np.maximum(np.maximum(below.real, below.imag), np.maximum(above.real, above.imag)) > 0.0).all():
            chosen.append(one)
    return np.unique(np.array(chosen, dtype=np.intp))


def moments(times: Iterable[float]) -> str:
    """Return a few moments [s] as words for a title."""
    return ", ".join(f"{time:.0f}" if time >= 99.95 else f"{round(time, 1) + 0.0:g}" for time in times) + " s"


def limits(axes: Axes, values: FloatArray) -> None:
    """Draw dashed lines at ± each of `values`, and make room for them."""
    for limit in np.unique(values):
        for sign in (-1.0, 1.0):
            axes.axhline(sign * limit, color="#606060", linewidth=0.8, linestyle="--", zorder=1.8)
    axes.set_ylim(-1.12 * values.max(), 1.12 * values.max())


def log_error_scale(axes: Axes, least: float, greatest: float) -> None:
    """Set a logarithmic scale for an error from `least` to `greatest` [m], over six decades at most."""
    axes.set_yscale("log")
    if 0.0 < greatest < np.inf:
        axes.set_ylim(max(least, 1e-6 * greatest, 1e-5) / 2.0, 2.0 * greatest)


def span(time: FloatArray, error: FloatArray) -> float:
    """Return the end of a run's interesting part [s]: well after the error last left 1 % of its peak.

    It is at most the last moment at which the error was known.
    """
    known = np.flatnonzero(np.isfinite(error))
    if not known.size:
        return float(time[-1]) if time.size else 0.0
    end = time[known[-1]]
    return float(np.clip(np.ceil(2.0 * formed_at(time, error)), min(5.0, end), end))


def formed_at(time: FloatArray, error: FloatArray) -> float:
    """Return when the error last left 1 % of its peak [s]; the start if it is never known."""
    known = np.flatnonzero(np.isfinite(error))
    if not known.size:
        return 0.0
    time, error = time[: known[-1] + 1], error[: known[-1] + 1]
    big = np.flatnonzero(np.nan_to_num(error, nan=np.inf) > 0.01 * np.nanmax(error[np.isfinite(error)]))
    return float(time[big[-1]] if big.size else time[0])


def equal_scales(axes: Axes, margin: float = 0.08) -> None:
    """Set equal scales in x and y, with room for marks and words at the border."""
    axes.set_aspect("equal", adjustable="datalim")
    box = axes.dataLim
    if np.isfinite(box.extents).all():
        axes.update_datalim(box.padded(margin * max(box.width, box.height)).get_points())
    axes.margins(0.0)
    axes.autoscale_view()


def without_wraps(angles: FloatArray) -> FloatArray:
    """Return angles with a gap where they wrap around, so that no line is drawn across."""
    apart = angles.copy()
    apart[1:][np.abs(np.diff(angles, axis=0)) > np.pi] = np.nan
    return apart


def legend(names: Sequence[str], robots: Sequence[LineStyle], *, chatter: bool = False) -> list[Any]:
    """Return legend handles of the leader and the followers; of many, a few. And of the band of `chatter`."""
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    chosen = range(len(robots)) if len(robots) <= 14 else (0, len(robots) // 2, len(robots) - 1)
    handles: list[Any] = [Line2D([], [], color=INK, linestyle=":", label=names[0])]
    handles += [
        Line2D([], [], color=robots[i].colour, linestyle=robots[i].dashes, label=names[i + 1]) for i in chosen
    ]
    handles.append(Line2D([], [], color="#606060", linestyle="--", linewidth=0.8, label="limits"))
    if chatter:
        handles.append(Patch(color=FAINT, alpha=0.25, linewidth=0.0, label="chatter"))
    return handles


def xy(point: complex) -> tuple[float, float]:
    """Return a point's coordinates for matplotlib."""
    return float(point.real), float(point.imag)


def draw(history: History, path: Path | str) -> None:
    """Write the panels of the paper's Fig. 2 of a simulation, in the format of `path`'s suffix.

    They end when the formation has formed. Raises ModuleNotFoundError without matplotlib, OSError if the file
    cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - only needed for drawing
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ModuleNotFoundError as missing:
        text = f"a figure {needs('matplotlib')}"
        raise ModuleNotFoundError(text, name=missing.name) from None
    last = span(history.time, history.error)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        _panels(figure, history, history.time <= last + 1e-9)
        figure.savefig(path, dpi=200)


def _panels(figure: Figure, history: History, shown: Any) -> None:
    grid = figure.add_gridspec(4, 2, height_ratios=(1.35, 0.85, 1.0, 1.0))
    layout, tracks = (figure.add_subplot(grid[0, column]) for column in (0, 1))
    side_by_side = figure.add_subplot(grid[1, :])
    angles, errors, speeds, turn_rates = (
        figure.add_subplot(grid[row, column]) for row in (2, 3) for column in (0, 1)
    )
    robots, time = line_styles(len(history.names) - 1), history.time[shown]
    graph(layout, history.names, history.edges, history.points[-1] - history.points[-1, 0], robots)
    layout.set(title="(a) Measurement graph")
    _formation(tracks, side_by_side, history, shown)
    chatter = over_time(angles, time, np.rad2deg(without_wraps(history.heading_error[shown])), robots)
    angles.set(title="(c) Heading errors", ylabel="estimate less truth [°]", ylim=(-190.0, 190.0))
    angles.set_yticks([-180, -90, 0, 90, 180])
    positive = np.where(history.error[shown] > 0.0, history.error[shown], np.nan)
    errors.plot(time, positive, color="black")
    if (finite := positive[np.isfinite(positive)]).size:
        log_error_scale(errors, float(finite.min()), float(finite.max()))
    errors.set(title="(d) Formation error", ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]")
    chatter |= over_time(speeds, time, history.speed[shown], robots)
    limits(speeds, history.max_speed)
    leader = np.abs(np.gradient(history.position[:, 0], history.time))[shown]
    speeds.plot(time, leader, color="black", linewidth=0.8, linestyle=":")
    speeds.set(title="(e) Forward speeds (leader dotted)", ylabel="$u$ [m/s]")
    chatter |= over_time(turn_rates, time, history.turn_rate[shown], robots)
    limits(turn_rates, history.max_turn_rate)
    turn_rates.set(title="(f) Turn rates", ylabel="$\\omega$ [rad/s]")
    for axes in (angles, errors, speeds, turn_rates):
        axes.set(xlabel="time [s]", xlim=(time[0], time[-1]))
    handles = legend(history.names, robots, chatter=chatter)
    figure.legend(
        handles=handles, loc="outside lower center", ncols=min(len(handles), 8), handlelength=2.2,
        columnspacing=1.4,
    )  # fmt: skip
    figure.suptitle(history.title, fontsize=9)


def _formation(tracks: Axes, side_by_side: Axes, history: History, shown: Any) -> None:
    """Draw paths with the first and the last formation; and the formation while it forms, side by side."""
    time, points, robots = history.time[shown], history.points[shown], line_styles(len(history.names) - 1)
    ends = points[[0, -1]]
    lines = np.concatenate([along_edges(end, history.edges) for end in ends])
    draw_paths(tracks, history.position[shown], history.names, robots, lines)
    formations(tracks, ends, history.edges)
    tracks.set(title=f"(b) Trajectories; formation at {moments(time[[0, -1]])}")
    last = int(np.searchsorted(time, formed_at(time, history.error[shown]))) or len(time) - 1
    chosen = np.linspace(0, min(last, len(time) - 1), SNAPSHOTS).astype(int)
    if np.isfinite(points[chosen]).all():
        snapshots(side_by_side, time[chosen], points[chosen], history.edges, robots)
    side_by_side.set_axis_off()
    side_by_side.set_title("The formation while it forms, side by side; leader black")


def over_time(axes: Axes, time: FloatArray, values: FloatArray, robots: Sequence[LineStyle]) -> bool:
    """Draw a `calm_line` for each robot, of `values` at each `time` [s], shape (T, F).

    Returns whether one chatters.
    """
    finite = values[np.isfinite(values)]
    extent = float(np.ptp(finite)) if finite.size else 0.0
    chatter = [
        calm_line(axes, time, column, extent, style) for column, style in zip(values.T, robots, strict=True)
    ]
    return any(chatter)


def calm_line(
    axes: Axes, time: FloatArray, values: FloatArray, extent: float, style: LineStyle, **options: Any
) -> bool:
    """Draw one line of `values` at each `time` [s], in a panel with values in a range of `extent`.

    Where it chatters, its running mean is drawn, and from its least to its greatest value a light band.
    Returns whether it does.
    """
    line, low, high = smoothed(time, values, CHATTER_SHARE * extent)
    axes.plot(time, line, color=style.colour, linestyle=style.dashes, **options)
    chatter = bool(np.isfinite(low).any())
    if chatter:
        axes.fill_between(time, low, high, color=style.colour, alpha=0.2, linewidth=0.0, zorder=1.5)
    return chatter


def smoothed(time: FloatArray, values: FloatArray, least: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a line, with its running mean where it chatters by more than `least`; there its band, else NaN.

    All have the shape (T,). The mean is weighted: equal weights would let alternating values through.
    """
    gone = np.full(len(values), np.nan)
    if len(values) <= MIN_CHATTER_SAMPLES:
        return values, gone, gone
    apart = max(float(np.median(np.diff(time))), CHATTER_TIME / MAX_CHATTER_SAMPLES)  # a NaN stays NaN
    samples = max(CHATTER_TIME / apart, MIN_CHATTER_SAMPLES) if apart > 0.0 else MIN_CHATTER_SAMPLES
    half = round(0.5 * samples)
    padded = np.pad(values, half, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    low, high = windows.min(axis=1), windows.max(axis=1)
    steps = np.lib.stride_tricks.sliding_window_view(np.abs(np.diff(padded)), 2 * half)
    chatters = (high - low > least) & (steps.sum(axis=1) > CHATTER_TURNS * (high - low))
    weights = np.hanning(2 * half + 3)[1:-1]
    line = np.where(chatters, windows @ (weights / weights.sum()), values)
    return line, np.where(chatters, low, np.nan), np.where(chatters, high, np.nan)
