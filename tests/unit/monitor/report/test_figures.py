"""Figures of a report and of a simulation."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure as Figure2D
from matplotlib.patches import Circle

from formation.control.arrays import ComplexArray, FloatArray
from formation.mission.file import load, read
from formation.monitor.report import drawing, figures, parts
from formation.monitor.report.gather import Run
from formation.monitor.report.parts import View
from formation.simulation.simulate import History, simulate
from formation.slots.shape import PlacedShape
from tests.support.examples import slow
from tests.support.monitored import Fleet
from tests.support.recordings import coming_in, run_of, talk


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of(tmp_path_factory.mktemp("run"), talk(Fleet(away=coming_in), 12.0))


@pytest.mark.slow
def test_report_writes_each_panel_and_both_paper_figures(run: Run, tmp_path: Path) -> None:
    paths = figures.write(tmp_path / "new" / "folder", figures.of_run(run, View.of([run])), ["svg"])
    names = {path.stem for path in paths}
    assert names == {"fig2", "fig3", "whole", *(panel.name for panel in parts.PANELS)}
    for path in paths:
        assert path.read_text(encoding="utf-8").startswith("<?xml")
    fig2 = (tmp_path / "new" / "folder" / "fig2.svg").read_text(encoding="utf-8")
    for letter in "abcdef":
        assert f"({letter})" in fig2


@pytest.mark.parametrize("truth", [True, False])
def test_posts_and_walls_are_drawn_only_in_simulation(truth: bool, tmp_path: Path) -> None:
    post = "[[simulation.posts]]\nx = 1.0\ny = 2.0\nradius = 0.3\n"
    wall = "[[simulation.walls]]\nbegin = [0, 0]\nend = [1, 1]\n"
    one = run_of(tmp_path, talk(Fleet(), 2.0, truth=truth), f"{read('six_robots')[0]}\n{post}{wall}")
    axes = Figure2D().subplots()
    parts.trajectories(axes, one, View.of([one]))
    posts = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert [(post.center, post.radius) for post in posts] == ([((1.0, 2.0), 0.3)] if truth else [])
    walls = [line for line in axes.lines if np.array_equal(line.get_xydata(), [[0.0, 0.0], [1.0, 1.0]])]
    assert len(walls) == truth


@pytest.mark.parametrize(
    ("suffix", "start"), [("svg", b"<?xml"), *slow(("png", b"\x89PNG"), ("pdf", b"%PDF"))]
)
def test_figure_file_is_reproducible(run: Run, suffix: str, start: bytes) -> None:
    once, again = (
        figures.written(figures.panel(run, View.of([run]), parts.PANELS[3]), suffix) for _ in range(2)
    )
    assert once.startswith(start)
    assert once == again


def test_panel_has_small_labels_and_distinct_line_styles(run: Run) -> None:
    figure = figures.panel(run, View.of([run]), parts.PANELS[5])
    assert figure.get_figwidth() == 3.5
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 10]  # type: ignore[arg-type]
    assert len({str(line.get_linestyle()) + str(vars(line)["_dash_pattern"]) for line in lines}) == 5
    assert {label.get_fontsize() for label in figure.axes[0].get_xticklabels()} == {8.0}


def test_view_ends_after_formation_or_at_given_time(run: Run) -> None:
    assert 8.0 <= View.of([run]).until <= 12.0
    assert View.of([run], 3.0).until == 3.0


@pytest.mark.slow
def test_compared_runs_have_the_same_axes(run: Run, tmp_path: Path) -> None:
    far = run_of(tmp_path, talk(Fleet(away=lambda r, t: 4.0 * coming_in(r, t)), 12.0))
    view = View.of([run, far])
    for which in parts.PANELS[1:]:
        first, second = (figures.panel(one, view, which).axes[0] for one in (run, far))
        assert first.get_xlim() == second.get_xlim()
        assert first.get_ylim() == second.get_ylim()


def test_names_are_shortened_if_only_numbers_differ() -> None:
    assert drawing.short_names(["robot1", "robot10", "robot11"]) == ["1", "10", "11"]
    assert drawing.short_names(["leader", "robot1"]) == ["leader", "robot1"]


def test_svg_of_six_robots_contains_no_raster_image(run: Run) -> None:
    svg = figures.written(figures.panel(run, View.of([run]), parts.PANELS[5]), "svg")
    assert b"<image" not in svg
    assert len(drawing.line_styles(100)) == 100


@pytest.mark.slow
def test_figure_with_silent_period_is_written(tmp_path: Path) -> None:
    run = run_of(tmp_path, [one for one in talk(Fleet(), 12.0) if not 13.0 < one.arrived < 18.0])
    panel = next(one for one in parts.PANELS if one.name == "forward_speeds")
    times = run.paths.time
    assert any(times[1:] == times[:-1])  # at the start of the gap; divided by zero once
    assert figures.written(figures.panel(run, View.of([run]), panel), "svg").startswith(b"<?xml")


@pytest.mark.slow
def test_many_orders_leave_room_for_the_curve(tmp_path: Path) -> None:
    def wants(time: float) -> dict[str, Any]:
        route = "" if time < 12.0 else "671f99bb423d"
        return {"shape": "wedge", "rotation": 1.0, "scale": 1.5, "route": route} if time >= 11.0 else {}

    fleet = Fleet(wants=wants)
    ordered = run_of(tmp_path, talk(fleet, 3.0))
    whole = figures.whole(ordered)
    whole.draw_without_rendering()
    assert whole.axes[0].get_position().height > 0.5
    assert {"run, hexagon", "wedge, 57.3°, × 1.5", "route"} <= {one.get_text() for one in whole.axes[0].texts}
    graph = figures.panel(ordered, View.of([ordered]), parts.PANELS[0]).axes[0]
    ends = {tuple(np.round(np.asarray(line.get_xydata())[0], 6)) for line in graph.lines}
    last = PlacedShape.of(fleet.order(13.0)).slots(fleet.mission)
    assert ends == {(round(slot.real, 6), round(slot.imag, 6)) for slot in last}


@pytest.fixture(scope="module")
def history() -> History:
    kept = simulate(load("six_robots"), horizon=10.0, keep=True).history
    assert kept is not None
    return kept


def test_figure_contains_panel_letters_quantities_and_robot_names(history: History, tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    drawing.draw(history, path)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<?xml")
    quantities = ("Measurement", "Trajectories", "Heading", "error", "speeds", "Turn")
    letters, names = (f"({letter})" for letter in "abcdef"), (f">{name}<" for name in history.names)
    assert not [wanted for wanted in (*quantities, *letters, *names, "time [s]") if wanted not in text]


def test_figure_with_unknown_values_is_drawn(history: History, tmp_path: Path) -> None:
    unknown = replace(
        history,
        heading_error=np.full_like(history.heading_error, np.nan),
        error=np.where(history.time < 5.0, history.error, np.nan),
        position=np.where(history.time[:, None] < 5.0, history.position, np.nan),
    )
    path = tmp_path / "figure.png"
    drawing.draw(unknown, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 10_000


@pytest.mark.slow
def test_figure_with_infinite_error_is_drawn(history: History, tmp_path: Path) -> None:
    lost, path = replace(history, error=np.full_like(history.error, np.inf)), tmp_path / "figure.png"
    drawing.draw(lost, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 10_000


def test_missing_matplotlib_error_names_install_command(
    history: History, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install '\.\[plot\]'"):
        drawing.draw(history, tmp_path / "figure.png")


def test_span_ends_after_formation_has_formed(history: History) -> None:
    span = drawing.span(history.time, history.error)
    assert 5.0 <= span <= 10.0
    assert history.error[np.searchsorted(history.time, span) - 1] < 0.01 * history.error.max()


def test_chatter_is_drawn_as_mean_and_band() -> None:
    time: FloatArray = 0.02 * np.arange(200.0)
    chattering = np.where(np.arange(200) % 2, 1.5, -1.5)
    values = np.where((time > 1.0) & (time < 3.0), chattering, 0.0)
    line, low, high = drawing.smoothed(time, values, 0.1)
    inside = (time > 1.4) & (time < 2.6)
    assert np.abs(line[inside]).max() < 0.05
    assert (low[inside] == -1.5).all()
    assert (high[inside] == 1.5).all()
    assert np.isnan(low[time < 0.7]).all()


@pytest.mark.parametrize("swing", [np.linspace(-1.5, 1.5, 200), np.sin(np.linspace(0.0, 9.0, 200)) ** 3])
def test_smooth_lines_are_unchanged(swing: Any) -> None:
    line, low, high = drawing.smoothed(np.arange(0.0, 4.0, 0.02), swing, 0.1)
    assert (line == swing).all()
    assert np.isnan(low).all()
    assert np.isnan(high).all()


def test_label_is_placed_away_from_the_line() -> None:
    line: ComplexArray = np.linspace(0.0, 3.0 + 1.0j, 50).astype(np.complex128)
    assert abs(drawing.roomiest(0j, line) + (3.0 + 1.0j) / abs(3.0 + 1.0j)) < 0.3
    across = drawing.roomiest(1.5 + 0.5j, line).conjugate() * (3.0 + 1.0j) / abs(3.0 + 1.0j)
    assert abs(across.imag) > 0.9


def test_snapshots_do_not_overlap(history: History) -> None:
    axes = Figure2D().subplots()
    points = history.points[[0, 50, 100, 400]]
    drawing.snapshots(axes, history.time[[0, 50, 100, 400]], points, history.edges, drawing.line_styles(5))
    spans: list[Any] = [np.asarray(one.get_offsets())[:, 0] for one in axes.collections]
    assert len(spans) == 4
    assert all(left.max() < right.min() for left, right in pairwise(spans))


def test_overlapping_formations_are_left_out_except_first_and_last() -> None:
    square: ComplexArray = np.array([0j, 1.0 + 0j, 1.0 + 1.0j, 1j])
    passing: ComplexArray = square + np.array([0.0, 0.5, 3.0, 4.5])[:, None]
    assert drawing.separate_formations(passing).tolist() == [0, 2, 3]
    assert drawing.separate_formations(passing[:2]).tolist() == [0, 1]
    assert drawing.separate_formations(passing[:1]).tolist() == [0]
