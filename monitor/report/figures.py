"""The figures of a recording: the panels of the paper's Fig. 2 and Fig. 3, alone and together.

Each panel is one column of a paper wide and its letters are 8 pt there. A panel states what is unknown.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from formation.monitor.report import drawing, parts
from formation.monitor.report.drawing import FAINT, STYLE
from formation.monitor.report.gather import Run
from formation.monitor.report.parts import PANELS, Panel, View
from formation.monitor.report.story import Ordered

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIG2, FIG3 = PANELS[:6], PANELS[1:4]
COLUMN_WIDTH, PAGE_WIDTH = 3.5, 7.1
"""Width of one column and of both [inches]."""
FORMATS = ("png", "svg", "pdf")
DPI = 300
MAX_MARKS = 40
"""Most orders and changes of the leader marked in the figure of a whole recording."""
CHANGED = "#D55E00"


@contextmanager
def _style() -> Iterator[None]:
    import matplotlib as mpl  # noqa: PLC0415 - needed only for drawing

    with mpl.rc_context(STYLE):
        yield


@_style()
def panel(run: Run, view: View, which: Panel) -> Figure:
    """Return one panel with the names of its lines."""
    figure = _figure(COLUMN_WIDTH, which.height)
    axes = figure.subplots()
    axes.set_title(which.title)
    which.draw(axes, run, view)
    if which.draw not in {parts.graph, parts.error}:
        _legend(figure, run, 4, limits=which.draw in {parts.speeds, parts.turn_rates})
    return figure


@_style()
def fig2(run: Run, view: View) -> Figure:
    """Return six panels over both columns, as the paper's Fig. 2."""
    figure = _figure(PAGE_WIDTH, 7.4)
    grid: Any = figure.subplots(3, 2, height_ratios=(1.35, 1.0, 1.0))
    for axes, which in zip(grid.flat, FIG2, strict=True):
        axes.set_title(which.title)
        which.draw(axes, run, view)
    _legend(figure, run, 7)
    return figure


@_style()
def fig3(run: Run, view: View) -> Figure:
    """Return trajectories, heading errors and formation error in one column, as the paper's Fig. 3."""
    figure = _figure(COLUMN_WIDTH, 6.6)
    grid: Any = figure.subplots(3, 1, height_ratios=(1.5, 1.0, 1.0))
    for axes, which, letter in zip(grid, FIG3, "abc", strict=True):
        axes.set_title(f"({letter}){which.title[3:]}")
        which.draw(axes, run, view)
    _legend(figure, run, 4, limits=False)
    return figure


@_style()
def whole(run: Run) -> Figure:
    """Return the formation error from the first message to the last, with the leader's orders."""
    figure = _figure(PAGE_WIDTH, 2.1)
    axes = figure.subplots()
    begin, end = (run.begin - run.start, run.end - run.start) if run.messages else (0.0, 0.0)
    axes.set_title("Formation error over the whole recording")
    parts.error(axes, run, View.of([run], end))
    axes.set_xlim(begin, max(end, begin + 0.1))
    for at, text, colour, top in _marks(run):
        axes.axvline(at, color=colour, linewidth=0.7)
        axes.annotate(
            text, (at, 0.97 if top else 0.03), xycoords=("data", "axes fraction"), xytext=(2, 0),
            textcoords="offset points", rotation=90, fontsize=6.5, color=colour,
            va="top" if top else "bottom",
        ).set_in_layout(False)  # fmt: skip
    return figure


def _marks(run: Run) -> Iterator[tuple[float, str, str, bool]]:
    """Yield the marks of a whole recording's figure: time [s], text, colour, whether on top."""
    for one in run.leader_terms[1 : MAX_MARKS + 1]:
        yield one.received.begin - run.start, f"{one.name} leads", CHANGED, True
    before: Ordered | None = None
    for order in run.story.orders[:MAX_MARKS]:
        if text := _change(before, order):
            yield order.at - run.start, text, FAINT, False
        before = order


def _change(before: Ordered | None, order: Ordered) -> str:
    motion = order.motion
    old = before.motion if before else motion._replace(shape="", rotation=0.0, scale=1.0, route="")
    return ", ".join(
        text
        for text, is_new in (
            (order.mode, before is None or order.mode != before.mode),
            (motion.shape, motion.shape != old.shape),
            (f"{math.degrees(motion.rotation):.3g}°", motion.rotation != old.rotation),
            (f"× {motion.scale:.3g}", motion.scale != old.scale),
            ("route", motion.route != old.route),
        )
        if is_new
    )


@_style()
def overlay(runs: Mapping[str, Run], view: View) -> Figure:
    """Return the formation errors of several runs on the same axes; `runs` is by name."""
    figure = _figure(PAGE_WIDTH, 2.7)
    axes = figure.subplots()
    axes.set_title("Formation error")
    parts.overlaid(axes, runs, view)
    figure.legend(loc="outside lower center", ncols=4, handlelength=2.6)
    return figure


def written(figure: Figure, suffix: str) -> bytes:
    """Return the figure as a file of this format, independent of the time of writing."""
    import matplotlib as mpl  # noqa: PLC0415

    metadata: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(suffix, {})
    file = io.BytesIO()
    with mpl.rc_context({**STYLE, "svg.hashsalt": "formation"}):
        figure.savefig(file, format=suffix, dpi=DPI, metadata=metadata)
    return file.getvalue()


def of_run(run: Run, view: View) -> dict[str, Figure]:
    """Return every figure of one run, by name."""
    figures = {"fig2": fig2(run, view), "fig3": fig3(run, view), "whole": whole(run)}
    return figures | {which.name: panel(run, view, which) for which in PANELS}


def write(folder: Path, figures: Mapping[str, Figure], formats: Sequence[str]) -> list[Path]:
    """Write figures by name into `folder`, which is made; return their paths. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        for suffix in formats:
            paths.append(folder / f"{name}.{suffix}")
            paths[-1].write_bytes(written(figure, suffix))
    return paths


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure  # noqa: PLC0415 - needed only for drawing

    return Figure(figsize=(width, height), layout="constrained")


def _legend(figure: Figure, run: Run, columns: int, *, limits: bool = True) -> None:
    handles = drawing.legend(run.mission.names, drawing.line_styles(len(run.mission.followers)))
    handles = handles if limits else handles[:-1]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=min(len(handles), columns),
        handlelength=2.2,
        fontsize=7,
    )
