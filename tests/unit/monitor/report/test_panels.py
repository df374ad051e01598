from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from formation.mission.file import load
from formation.monitor.report import drawing
from formation.simulation.simulate import History, simulate


@pytest.fixture(scope="module")
def history() -> History:
    kept = simulate(load("six_robots"), horizon=10.0, keep=True).history
    assert kept is not None
    return kept


@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_the_suffix_says_how_the_figure_is_written(
    history: History, tmp_path: Path, suffix: str, start: bytes
) -> None:
    path = tmp_path / f"figure.{suffix}"
    drawing.draw(history, path)
    assert path.read_bytes().startswith(start)


def test_every_panel_names_its_quantity_and_unit(history: History, tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    drawing.draw(history, path)
    text = path.read_text(encoding="utf-8")
    for letter, quantity in zip(
        "abcdef", ("Measurement", "Trajectories", "Heading", "error", "speeds", "Turn"), strict=True
    ):
        assert f"({letter})" in text
        assert quantity in text
    for name in history.names:
        assert f">{name}<" in text
    assert "time [s]" in text


def test_what_is_not_known_is_left_out_of_the_figure(history: History, tmp_path: Path) -> None:
    unknown = replace(
        history,
        heading_error=np.full_like(history.heading_error, np.nan),
        error=np.where(history.time < 5.0, history.error, np.nan),
        position=np.where(history.time[:, None] < 5.0, history.position, np.nan),
    )
    path = tmp_path / "figure.png"
    drawing.draw(unknown, path)
    assert path.stat().st_size > 10_000


def test_a_run_that_left_the_numbers_can_still_be_drawn(history: History, tmp_path: Path) -> None:
    lost = replace(history, error=np.full_like(history.error, np.inf))
    drawing.draw(lost, tmp_path / "figure.png")


def test_without_matplotlib_the_error_says_what_to_install(
    history: History, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install '\.\[plot\]'"):
        drawing.draw(history, tmp_path / "figure.png")


def test_the_figure_ends_well_after_the_formation_has_formed(history: History) -> None:
    span = drawing.span(history.time, history.error)
    assert 5.0 <= span <= 10.0
    assert history.error[np.searchsorted(history.time, span) - 1] < 0.01 * history.error.max()
