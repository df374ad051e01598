"""`formation report`: files, output and refusals. Other tests check the page itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.deploy.recordings import report
from formation.monitor.report import figures
from tests.support.monitored import Fleet
from tests.support.recordings import coming_in, record, talk
from tests.unit.deploy.commands import Capsys, output_of, refused


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "monday.mcap"
    record(path, talk(Fleet(away=coming_in), 9.0))
    return path


@pytest.fixture
def plain_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pages without figures, which take a second to draw."""
    monkeypatch.setattr(report, "page", lambda *_: f"{report.GENERATOR.decode()}</html>")


def test_page_is_written_beside_recording_and_json_to_stdout(recording: Path, capsys: Capsys) -> None:
    assert main(["report", str(recording), "--json"]) == 0
    out, words = capsys.readouterr()
    result = json.loads(out)
    assert result["report"] == str(recording.with_suffix(".html"))
    (run,) = result["runs"]
    assert 4.0 < run["settling_time"] < 8.0
    assert run["converged"] is True
    assert run["robots"]["robot2"]["error_rms"] > 0.0
    text = recording.with_suffix(".html").read_text(encoding="utf-8")
    assert "six-robots, field law: no problem found" in text  # as `formation check` prints
    assert f"{run['settling_time']:.2f} s" in text
    assert "Converged" in words


@pytest.mark.slow
def test_figures_are_written_in_requested_format(recording: Path, tmp_path: Path, capsys: Capsys) -> None:
    flags = ["-o", str(tmp_path / "page.html"), "--figures", str(tmp_path / "f"), "--format", "pdf", "--json"]
    assert main(["report", str(recording), *flags]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {Path(path).suffix for path in result["figures"]} == {".pdf"}
    assert (tmp_path / "f" / "fig2.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_two_recordings_are_compared_with_figures_in_separate_folders(
    recording: Path, tmp_path: Path, capsys: Capsys
) -> None:
    record(tmp_path / "other.mcap", talk(Fleet(away=coming_in), 6.0), law="paper")
    flags = ["-o", str(tmp_path / "page.html"), "--figures", str(tmp_path / "f"), "--format", "svg"]
    out = output_of(capsys, ["report", str(recording), str(tmp_path / "other.mcap"), *flags])
    assert "A: six-robots, field law" in out
    assert "B: six-robots, paper law" in out
    assert {path.name for path in (tmp_path / "f").iterdir()} == {"a", "b", "overlay.svg"}


def test_cut_recording_is_reported_as_cut(
    recording: Path, tmp_path: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "written", lambda *_: b"<svg></svg>")
    cut = tmp_path / "cut.mcap"
    data = recording.read_bytes()
    cut.write_bytes(data[: 2 * len(data) // 3])
    assert "is cut" in output_of(capsys, ["report", str(cut)])
    assert "This recording is cut off" in cut.with_suffix(".html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["{missing}"], "cannot be read: No such file"),
        (["{text}"], "is no recording that `formation` made"),
        (["{run}", "{text}"], "is no recording that `formation` made"),
        (["{run}", "-o", "{run}"], "is the recording itself; name another file"),
        (["{run}", "-o", "{folder}"], "is a folder; name a file"),
        (["{run}", "-o", "{text}/page.html"], "text.txt is a file, and no folder"),
        (["{run}", "-o", "{mission}"], "wedge_5.toml: must end in .html"),
        (["{run}", "-o", "{text}"], "text.txt: must end in .html"),
        (["{run}", "-o", "{other}"], "home.html: exists already, and is no report; name another file"),
        (["{run}", "-o", "{folder}/{long}.html"], "File name too long"),
        (["{run}", "-o", "{folder}/p.html", "--figures", "{text}"], "text.txt is a file, and no folder"),
        (["{run}", "--format", "gif"], "must be one or more of png, svg, pdf"),
        (["{run}", "--format", "pdf"], "--format: needs --figures DIR"),
        (["{run}", "--until", "0"], "above 0"),
        ([], "FILE"),
    ],
)
@pytest.mark.usefixtures("plain_page")
def test_illegal_files_and_flags_are_refused_without_changes(
    flags: list[str], named: str, recording: Path, tmp_path: Path, capsys: Capsys
) -> None:
    names = {"run": "run.mcap", "text": "text.txt", "mission": "wedge_5.toml", "other": "home.html"}
    for name in names.values():
        (tmp_path / name).write_text("<!DOCTYPE html>, but not of a recording")
    (tmp_path / "run.mcap").write_bytes(recording.read_bytes())
    places = {name: tmp_path / file for name, file in names.items()}
    places |= {"missing": tmp_path / "no.mcap", "folder": tmp_path, "long": Path("long" * 75)}
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    err = refused(capsys, ["report", *(flag.format(**places) for flag in flags)])
    assert named in err
    assert err.count("\n") == 1 or "usage" in err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.usefixtures("plain_page")
def test_report_overwrites_older_report(recording: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.touch()
    for _ in range(2):
        assert main(["report", str(recording), "-o", str(page), "--until", "2"]) == 0
    assert "</html>" in page.read_text(encoding="utf-8")
