"""The parts of a recording's figures: one set of axes each. A part states what is unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from formation.control.arrays import FloatArray
from formation.monitor.report import drawing, words
from formation.monitor.report.drawing import FAINT, INK, MANY_ROBOTS
from formation.monitor.report.gather import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ANGLES = (2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 180.0)
"""Possible ends of the scale of heading errors [°]."""


@dataclass(frozen=True, slots=True)
class View:
    """The common axes of several runs."""

    until: float
    """Last moment [s]."""
    error: tuple[float, float]
    """Least and greatest formation error [m]."""
    heading: float
    """Greatest heading error [°]."""
    inputs: tuple[float, float]
    """Greatest limit of speed [m/s] and turn rate [rad/s]."""
    box: tuple[complex, complex] | None
    """Lower left and upper right corner of all paths [m; world frame]."""

    @classmethod
    def of(cls, runs: Sequence[Run], until: float | None = None) -> View:
        """Return the axes that show the relevant part of all `runs`; `until` [s] overrides their end."""
        last = max(map(_until, runs)) if until is None else until
        specs = [run.mission.robots[name] for run in runs for name in run.mission.followers]
        return cls(
            until=max(last, 0.1),
            error=_error_range(runs, last),
            heading=_heading_range(runs, last),
            inputs=(max(spec.max_speed for spec in specs), max(spec.max_turn_rate for spec in specs)),
            box=_box(runs, last),
        )


def _until(run: Run) -> float:
    """Return the end of a run's interesting part [s]: after settling, or all if it did not settle."""
    seen = run.paths.time[np.isfinite(run.paths.points).any(axis=1)]
    last, settled = float(seen[-1]) if seen.size else 0.0, run.snapshot.settled_at
    if settled is None or not run.known:
        return last
    time, values = run.formation.line(0)
    shown = time >= 0.0
    return min(max(drawing.span(time[shown], values[shown]), float(np.ceil(1.4 * settled))), last)


def _error_range(runs: Sequence[Run], until: float) -> tuple[float, float]:
    values = np.concatenate([run.formation.until(until)[:, 0] for run in runs])
    values = values[np.isfinite(values) & (values > 0.0)]
    return (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)


def _heading_range(runs: Sequence[Run], until: float) -> float:
    values = np.concatenate([np.zeros(1), *(np.abs(run.headings.until(until)).ravel() for run in runs)])
    greatest = values[np.isfinite(values)].max()
    return next((angle for angle in ANGLES if np.rad2deg(greatest) <= angle), ANGLES[-1])


def _box(runs: Sequence[Run], until: float) -> tuple[complex, complex] | None:
    parts = []
    for run in runs:
        shown = (run.paths.time >= 0.0) & (run.paths.time <= until)
        both = np.concatenate([run.paths.centres[shown].ravel(), run.paths.points[shown].ravel()])
        parts.append(both[np.isfinite(both)])
    if len(runs) < 2 or not all(part.size for part in parts):
        return None
    points = np.concatenate(parts)
    low = complex(points.real.min(), points.imag.min())
    high = complex(points.real.max(), points.imag.max())
    margin = 0.06 * abs(high - low) * (1 + 1j)
    return low - margin, high + margin


class Panel(NamedTuple):
    """One panel."""

    name: str
    """Name of its file."""
    title: str
    height: float
    """Height at the width of a column [inches]."""
    draw: Callable[[Axes, Run, View], None]


def graph(axes: Axes, run: Run, _view: View) -> None:
    """(a) Draw the sensing graph at the slots."""
    mission = run.mission
    points = np.array(run.snapshot.placed_shape.slots(mission), dtype=np.complex128)
    drawing.graph(axes, mission.names, edges(run), points, drawing.line_styles(len(mission.followers)))


def trajectories(axes: Axes, run: Run, view: View) -> None:
    """(b) Draw the centres' paths, and formations: the first, the last, and others that lie apart."""
    paths, mission = run.paths, run.mission
    shown = (paths.time >= -1e-9) & (paths.time <= view.until + 1e-9) & np.isfinite(paths.points).any(axis=1)
    if not shown.any():
        _unknown(axes, "no positions were recorded")
        return
    time, points = paths.time[shown], paths.points[shown]
    moments = np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], 4)).clip(0, len(time) - 1))
    moments = moments[drawing.separate_formations(points[moments])]
    lines = np.concatenate([drawing.along_edges(points[moment], edges(run)) for moment in moments])
    drawing.draw_paths(
        axes, paths.centres[shown], mission.names, drawing.line_styles(len(mission.followers)), lines
    )
    drawing.formations(axes, points[moments], edges(run))
    if run.truth:  # in the field [simulation] is about another world
        drawing.draw_obstacles(axes, mission.simulation)
    axes.set_title(f"{axes.get_title(loc='left')}; formation at {drawing.moments(time[moments])}", loc="left")
    if view.box is not None:
        low, high = view.box
        axes.set_aspect("equal", adjustable="box", anchor="W")
        axes.set(xlim=(low.real, high.real), ylim=(low.imag, high.imag))


def headings(axes: Axes, run: Run, view: View) -> None:
    """(c) Draw estimated less true heading."""
    axes.set(ylabel="estimate less truth [°]", xlabel="time [s]", xlim=(0.0, view.until))
    if not run.truth:
        _unknown(axes, "not known: no ground truth was recorded")
        return

    def degrees(i: int) -> tuple[FloatArray, FloatArray]:
        time, angles = run.headings.line(i)
        return time, np.rad2deg(drawing.without_wraps(angles))

    _lines(axes, run, degrees, view)
    axes.set_ylim(-1.06 * view.heading, 1.06 * view.heading)
    axes.set_yticks([share * view.heading for share in (-1.0, -0.5, 0.0, 0.5, 1.0)])


def error(axes: Axes, run: Run, view: View) -> None:
    """(d) Draw the formation error, estimated and true; the bound, and when it was reached for good."""
    axes.set(ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]", xlabel="time [s]", xlim=(0.0, view.until))
    if not run.known:
        _unknown(axes, "never known: positions of some robot are missing")
        return
    time, values = _positive(*run.formation.line(0))
    axes.plot(time, values, color=INK, label="as the robots say")
    time, values = _positive(*run.formation.line(1))
    if np.isfinite(values).any():
        axes.plot(time, values, color="#D55E00", linewidth=0.8, linestyle=(0, (3, 2)), label="in truth")
    drawing.log_error_scale(axes, *view.error)
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
    """(g) Draw each follower's share of the formation error."""
    axes.set(ylabel="$\\Sigma_j\\,|z_{ij}-z_{ij}^*|$ [m]", xlabel="time [s]", xlim=(0.0, view.until))
    if not any(robot.error.whole.count for robot in run.robots.values()):
        _unknown(axes, "never known")
        return
    _lines(axes, run, lambda i: _positive(*run.errors.line(i)), view)
    drawing.log_error_scale(axes, view.error[0] / (2.0 * len(run.robots)), view.error[1])


def speeds(axes: Axes, run: Run, view: View) -> None:
    """(e) Draw commanded forward speeds, their limits, and the leader's speed."""
    axes.set(ylabel="$u$ [m/s]", xlabel="time [s]", xlim=(0.0, view.until))
    _commands(axes, run, view, 0)
    leader, time = run.paths.centres[:, 0], run.paths.time
    if np.isfinite(leader).sum() > 2:
        with np.errstate(divide="ignore", invalid="ignore"):  # both ends of a gap have the same time
            speed = np.abs(np.gradient(leader, time))
        axes.plot(time, speed, color=INK, linewidth=0.8, linestyle=":")


def turn_rates(axes: Axes, run: Run, view: View) -> None:
    """(f) Draw commanded turn rates and their limits."""
    axes.set(ylabel="$\\omega$ [rad/s]", xlabel="time [s]", xlim=(0.0, view.until))
    _commands(axes, run, view, 1)


PANELS = (
    Panel("graph", "(a) Measurement graph", 2.9, graph),
    Panel("trajectories", "(b) Trajectories", 2.9, trajectories),
    Panel("heading_errors", "(c) Heading errors", 2.3, headings),
    Panel("formation_error", "(d) Formation error", 2.3, error),
    Panel("forward_speeds", "(e) Forward speeds (leader dotted)", 2.3, speeds),
    Panel("turn_rates", "(f) Turn rates", 2.3, turn_rates),
    Panel("robot_errors", "(g) Error of each robot", 2.3, robot_errors),
)


def overlaid(axes: Axes, runs: Mapping[str, Run], view: View) -> None:
    """Draw the formation errors of several runs, by label."""
    axes.set(ylabel="$\\Sigma\\,|z_{ij}-z_{ij}^*|$ [m]", xlabel="time [s]", xlim=(0.0, view.until))
    for (name, run), style in zip(runs.items(), drawing.line_styles(len(runs)), strict=True):
        if run.known:
            time, values = _positive(*run.formation.line(0))
            axes.plot(time, values, color=style.colour, linestyle=style.dashes, linewidth=1.3, label=name)
    drawing.log_error_scale(axes, *view.error)
    for bound in sorted({run.mission.settled for run in runs.values()}):
        axes.axhline(bound, color=FAINT, linewidth=0.8, linestyle=":", label=f"bound {words.bound(bound)}")


def edges(run: Run) -> list[tuple[int, int]]:
    """Return (i, j) by index into the mission's names: robot i measures robot j."""
    index = {name: i for i, name in enumerate(run.mission.names)}
    return [(index[robot], index[other]) for robot, other in run.snapshot.edges]


def _commands(axes: Axes, run: Run, view: View, column: int) -> None:
    if not any(len(curves.time) for curves in run.commands.values()):
        _unknown(axes, "no commands were recorded")
        return
    curves = list(run.commands.values())
    _lines(axes, run, lambda i: curves[i].line(column), view, 2.0 * view.inputs[column])
    specs = [run.mission.robots[name] for name in run.mission.followers]
    values = [spec.max_turn_rate if column else spec.max_speed for spec in specs]
    drawing.limits(axes, np.array(values))
    axes.set_ylim(-1.12 * view.inputs[column], 1.12 * view.inputs[column])


def _lines(
    axes: Axes,
    run: Run,
    line: Callable[[int], tuple[FloatArray, FloatArray]],
    view: View,
    extent: float = np.inf,
) -> None:
    """Draw one line for each follower, up to the end of the view.

    With `extent`, the range of the panel's values, lines that chatter are smoothed.
    """
    count = len(run.mission.followers)
    for i, style in enumerate(drawing.line_styles(count)):
        time, values = line(i)
        shown = (time >= -1.0) & (time <= view.until + 1.0)
        many = count > MANY_ROBOTS
        drawing.calm_line(axes, time[shown], values[shown], extent, style, linewidth=0.9, rasterized=many)


def _unknown(axes: Axes, why: str) -> None:
    axes.grid(visible=False)
    axes.set(xticks=[], yticks=[])
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center", color=FAINT)


def _positive(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    return time, np.where(values > 0.0, values, np.nan)
