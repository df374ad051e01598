from __future__ import annotations

import json
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.deploy.terminal.bar import Bar
from tests.unit.deploy.commands import Capsys, output_of, refused
from tests.unit.monitor.recording.test_recover import chunked


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    chunked(path)
    path.write_bytes(path.read_bytes()[:-3000])
    return path


def test_recover_writes_file_and_reports_loss(cut: Path, capsys: Capsys) -> None:
    result = output_of(capsys, ["recover", str(cut)])
    out = cut.with_name("run-recovered.mcap")
    assert out.exists()
    assert f"{cut} is cut off, or still being written. " in result
    assert f"are in {out}." in result
    assert "lost: what was received after that, within a second of the end" in result
    assert f"{out} is whole: " in output_of(capsys, ["recover", str(out)])
    assert sorted(one.name for one in cut.parent.iterdir()) == ["run-recovered.mcap", "run.mcap"]


def test_recover_json_reports_recovered_file_and_times(cut: Path, tmp_path: Path, capsys: Capsys) -> None:
    out = tmp_path / "elsewhere.mcap"
    assert main(["recover", str(cut), "-o", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["whole"], result["recovered"], result["damaged_stretches"]) == (False, str(out), 0)
    assert result["messages"] > 100
    assert result["start"] < result["end"]


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\1" * 500])
def test_recover_refuses_file_that_is_no_recording(tmp_path: Path, content: bytes, capsys: Capsys) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    err = refused(capsys, ["recover", str(path)])
    assert err == f"formation: {path}: is no recording that `formation` made\n"
    assert [one.name for one in tmp_path.iterdir()] == ["run.mcap"]


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ("{folder}/no.mcap", "no.mcap: cannot be read: No such file or directory"),
        ("{folder}", "cannot be read: Is a directory"),
        (".", ".: cannot be read: Is a directory"),
        ("{cut} -o {cut}", "formation: --out {cut}: exists already; name a new file\n"),
        ("{cut} -o {cut}/x.mcap", "run.mcap is no folder"),
    ],
)
def test_recover_refuses_unreadable_input_and_blocked_output(
    arguments: str, why: str, cut: Path, capsys: Capsys
) -> None:
    said = refused(capsys, ["recover", *arguments.format(folder=cut.parent, cut=cut).split()])
    assert why.format(cut=cut) in said


def test_recover_shows_progress_of_checking_and_copying(cut: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shares: list[float] = []
    monkeypatch.setattr(Bar, "at", lambda _bar, share: shares.append(share))
    assert main(["recover", str(cut)]) == 0
    assert shares == sorted(shares)
    assert shares[0] < 0.5 < shares[-1] <= 1.0
