"""`formation replay` on the command line: refusals in one line, and short replays."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from formation.deploy.cli import main
from tests.support.monitored import EPOCH, Fleet
from tests.unit.monitor.recording.test_recorder import recorder

QUIET = ("--no-page", "--no-zenoh")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording of two seconds of six robots."""
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    with recorder(path) as recording:
        for sample in Fleet().positions(10.0, 12.0):
            recording.write(sample, sample.arrived + EPOCH)
    return path


@pytest.mark.parametrize(
    ("flags", "result"),
    [
        (
            ["--prefix", "robot2"],
            "--prefix 'robot2': live keys begin with 'robot2' as well; name another word",
        ),
        (["--prefix", ""], "--prefix '': must be words joined by '/'"),
        (["--start", "100"], "--start 100: the recording is over after 2.0 s"),
        (["--start", "1", "--until", "0.5"], "--until 0.5: must be later than --start 1"),
        (["-e", "nonsense"], "--connect 'nonsense': must be PROTOCOL/HOST:PORT"),
        (["--cfg", "nonsense"], "--cfg 'nonsense': must be PATH:VALUE"),
    ],
)
def test_bad_flag_is_refused_in_one_line(
    flags: list[str], result: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(path), "--no-page", *flags]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"formation: {result}")
    assert err.count("\n") == 1


@pytest.mark.parametrize("flags", [["--speed", "0"], ["--speed", "101"], ["--start", "-1"], ["--page", "x"]])
def test_refusal_of_bad_value_names_flag(
    flags: list[str], path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(path), *flags]) == 2
    assert f"formation: {flags[0]}" in capsys.readouterr().err


@pytest.mark.parametrize("content", [None, b"", b"\x89MCAP0\r\n", b"no recording at all"])
def test_missing_or_damaged_recording_is_refused(
    content: bytes | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "what.mcap"
    if content is not None:
        path.write_bytes(content)
    assert main(["replay", str(path), *QUIET]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"formation: {path}: ")
    assert err.count("\n") == 1


def test_replay_plays_from_start_to_until(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(path), *QUIET, "--start", "0.5", "--until", "1.5", "--speed", "20"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("0:01.5 of 0:01.5  20x")


def test_replay_serves_page_by_default(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(path), "--no-zenoh", "--speed", "20"]) == 0
    assert "page: http://127.0.0.1:" in capsys.readouterr().out


def test_taken_page_address_is_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["replay", str(path), "--no-zenoh", "--page", where]) == 2
    assert f"formation: --page {where}: Address already in use" in capsys.readouterr().err
