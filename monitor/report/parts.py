"""The parts of a recording's figures: one set of axes each. What is not known a part says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from formation.arrays import FloatArray
from formation.figure import Figure
from monitor.report import drawing, words
from monitor.report.drawing import FAINT, INK, MANY
from monitor.report.gather import Run
from monitor.report.view import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Panel(NamedTuple):
    """One panel."""

    name: str
    """Of its file."""
    title: str
    height: float
    """[inches] at the width of a column."""
    draw: Callable[[Axes, Run, View], None]


def graph(axes: Axes, run: Run, _view: View) -> None:
    """(a) Who measures whom, where everybody belongs."""
    mission = run.mission
    figure = run.snapshot.figure or Figure.first(mission)
    points = np.array(figure.slots(mission), dtype=np.complex128)
    drawing.graph(axes, mission.names, edges(run), points, drawing.looks(len(mission.followers)))


def trajectories(axes: Axes, run: Run, view: View) -> None:
    """(b) Ways of the centres, and the formation at four moments."""
    ways, mission = run.ways, run.mission
    shown = (ways.time >= -1e-9) & (ways.time <= view.until + 1e-9) & np.isfinite(ways.points).any(axis=1)
    if not shown.any():
        _unknown(axes, "no positions were recorded")
        return
    drawing.ways(axes, ways.centres[shown], mission.names, drawing.looks(len(mission.followers)))
    time, points = ways.time[shown], ways.points[shown]
    moments = np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], 4)).clip(0, len(time) - 1))
    drawing.formations(axes, points[moments], edges(run))
    if run.truth:  # in the field [simulation] is about another world
        drawing.things(axes, mission.simulation)
    axes.set_title(f"{axes.get_title(loc='left')}; formation at {drawing.moments(time[moments])}", loc="left")
    if view.box is not None:
        low, high = view.box
        axes.set_aspect("equal", adjustable="box", anchor="W")
        axes.set(xlim=(low.real, high.real), ylim=(low.imag, high.imag))


def headings(axes: Axes, run: Run, view: View) -> None:
    """(c) Estimated less true heading."""
    axes.set(ylabel="estimate less truth [°]", xlabel="time [s]", xlim=(0.0, view.until))
    if not run.truth:
        _unknown(axes, "not known: no ground truth was recorded")
        return
    degrees = run.headings._replace(low=np.rad2deg(run.headings.low), high=np.rad2deg(run.headings.high))
    _lines(axes, run, lambda i: _unjoined(*degrees.line(i)), view)
    axes.set_ylim(-1.06 * view.heading, 1.06 * view.heading)
    axes.set_yticks([share * view.heading for share in (-1.0, -0.5, 0.0, 0.5, 1.0)])


def error(axes: Axes, run: Run, view: View) -> None:
    """(d) Formation error, as robots say and in truth; the bound, and when it was reached for good."""
    axes.set(ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]", xlabel="time [s]", xlim=(0.0, view.until))
    if not run.known:
        _unknown(axes, "never known: some robot was not heard")
        return
    time, values = _positive(*run.formation.line(0))
    axes.plot(time, values, color=INK, label="as the robots say")
    time, values = _positive(*run.formation.line(1))
    if np.isfinite(values).any():
        axes.plot(time, values, color="#D55E00", linewidth=0.8, linestyle=(0, (3, 2)), label="in truth")
    drawing.falling(axes, *view.error)
    bound, settled = run.mission.settled, run.snapshot.settled_at
    axes.axhline(bound, color=FAINT, linewidth=0.8, linestyle=":")
    if settled is not None:
        axes.axvline(settled, color=FAINT, linewidth=0.8, linestyle=":")
        early = settled < 0.5 * sum(axes.get_xlim())
        axes.annotate(
            f"under {words.bound(bound)} from {settled:.2f} s", (settled, bound), fontsize=7,
            xytext=(4, 3) if early else (-4, -9), textcoords="offset points", ha="left" if early else "right",
        ).set_in_layout(False)  # fmt: skip
    if len(axes.lines) > 2:
        axes.legend(
            loc="best", fontsize=7, frameon=True, edgecolor="none", facecolor="white", framealpha=0.85
        )


def robot_errors(axes: Axes, run: Run, view: View) -> None:
    """(g) Each follower's share of the formation error."""
    axes.set(ylabel="$\\Sigma_j\\,|z_{ij}-z_{ij}^*|$ [m]", xlabel="time [s]", xlim=(0.0, view.until))
    if not any(robot.error.whole.count for robot in run.robots.values()):
        _unknown(axes, "never known")
        return
    _lines(axes, run, lambda i: _positive(*run.errors.line(i)), view)
    drawing.falling(axes, view.error[0] / (2.0 * len(run.robots)), view.error[1])


def speeds(axes: Axes, run: Run, view: View) -> None:
    """(e) Commanded forward speeds, their limits, and how fast the leader was."""
    axes.set(ylabel="$u$ [m/s]", xlabel="time [s]", xlim=(0.0, view.until))
    _commands(axes, run, view, 0)
    leader, time = run.ways.centres[:, 0], run.ways.time
    if np.isfinite(leader).sum() > 2:
        with np.errstate(divide="ignore", invalid="ignore"):  # a gap's two ends have one time, and no place
            speed = np.abs(np.gradient(leader, time))
        axes.plot(time, speed, color=INK, linewidth=0.8, linestyle=":")


def turn_rates(axes: Axes, run: Run, view: View) -> None:
    """(f) Commanded turn rates and their limits."""
    axes.set(ylabel="$\\omega$ [rad/s]", xlabel="time [s]", xlim=(0.0, view.until))
    _commands(axes, run, view, 1)


PANELS = (
    Panel("graph", "(a) Who measures whom", 2.9, graph),
    Panel("trajectories", "(b) Trajectories", 2.9, trajectories),
    Panel("heading_errors", "(c) Heading errors", 2.3, headings),
    Panel("formation_error", "(d) Formation error", 2.3, error),
    Panel("forward_speeds", "(e) Forward speeds (leader dotted)", 2.3, speeds),
    Panel("turn_rates", "(f) Turn rates", 2.3, turn_rates),
    Panel("robot_errors", "(g) Error of each robot", 2.3, robot_errors),
)


def overlaid(axes: Axes, runs: Mapping[str, Run], view: View) -> None:
    """Formation errors of several runs, by what each is called."""
    axes.set(ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]", xlabel="time [s]", xlim=(0.0, view.until))
    for (name, run), look in zip(runs.items(), drawing.looks(len(runs)), strict=True):
        if run.known:
            time, values = _positive(*run.formation.line(0))
            axes.plot(time, values, color=look.colour, linestyle=look.dashes, linewidth=1.3, label=name)
    drawing.falling(axes, *view.error)
    for bound in sorted({run.mission.settled for run in runs.values()}):
        axes.axhline(bound, color=FAINT, linewidth=0.8, linestyle=":", label=f"bound {words.bound(bound)}")


def edges(run: Run) -> list[tuple[int, int]]:
    """(i, j) by index into the mission's names: robot i measures robot j."""
    index = {name: i for i, name in enumerate(run.mission.names)}
    return [
        (index[name], index[other])
        for name in run.mission.names
        for other in run.mission.robots[name].neighbours
    ]


def _commands(axes: Axes, run: Run, view: View, column: int) -> None:
    if not any(len(curves.time) for curves in run.commands.values()):
        _unknown(axes, "no commands were recorded")
        return
    curves = list(run.commands.values())
    _lines(axes, run, lambda i: curves[i].line(column), view)
    specs = [run.mission.robots[name] for name in run.mission.followers]
    values = [spec.max_turn_rate if column else spec.max_speed for spec in specs]
    drawing.limits(axes, np.array(values))
    axes.set_ylim(-1.12 * view.inputs[column], 1.12 * view.inputs[column])


def _lines(axes: Axes, run: Run, line: Callable[[int], tuple[FloatArray, FloatArray]], view: View) -> None:
    """One line for each follower, as far as it is shown."""
    count = len(run.mission.followers)
    for i, look in enumerate(drawing.looks(count)):
        time, values = line(i)
        shown = (time >= -1.0) & (time <= view.until + 1.0)
        axes.plot(
            time[shown], values[shown], color=look.colour, linestyle=look.dashes, linewidth=0.9,
            rasterized=count > MANY,
        )  # fmt: skip


def _unknown(axes: Axes, why: str) -> None:
    """Say in an empty panel why it is empty."""
    axes.grid(visible=False)
    axes.set(xticks=[], yticks=[])
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center", color=FAINT)


def _positive(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """For a logarithmic scale."""
    return time, np.where(values > 0.0, values, np.nan)


def _unjoined(time: FloatArray, degrees: FloatArray) -> tuple[FloatArray, FloatArray]:
    apart = degrees.copy()
    apart[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return time, apart
