"""`formation run`: what it refuses before any process starts."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from formation.deploy.local import run
from formation.deploy.refusal import Refusal
from formation.mission.file import read
from formation.mission.model import Mission
from formation.monitor.web.address import IN_USE, NOT_HERE
from tests.unit.deploy.commands import Capsys, refused


@pytest.fixture(autouse=True)
def no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in an empty folder, and fail if a process is about to start."""

    def start(*_: object) -> None:
        pytest.fail("a process starts")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "start", start)


def test_page_address_of_another_machine_is_refused(tmp_path: Path, capsys: Capsys) -> None:
    err = refused(capsys, ["run", "--page", "192.0.2.1:8460"])
    assert err == f"formation: --page 192.0.2.1:8460: Cannot assign requested address: {NOT_HERE}\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("flags", "end"), [((), "30"), (("--duration", "10"), "10")])
def test_fault_that_begins_after_the_run_is_refused(flags: tuple[str, ...], end: str, capsys: Capsys) -> None:
    err = refused(capsys, ["run", "--fault", "robot2:frozen@30", *flags])
    why = f"must begin before the run ends, after {end} s (--duration)"
    assert err == f"formation: --fault 'robot2:frozen@30': {why}\n"


def test_too_long_recording_in_new_folder_is_refused(capsys: Capsys) -> None:
    record = f"new/{'long' * 75}.mcap"
    assert (
        refused(capsys, ["run", "--record", record]) == f"formation: --record {record}: File name too long\n"
    )


def test_bundles_run_here_without_their_certificates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    (tmp_path / "field" / "desk").mkdir(parents=True)
    text, _ = read("turtlebot3_pair")
    (tmp_path / "field" / "desk" / "mission.toml").write_text(text, encoding="utf-8")
    sources: list[str] = []

    def plan(_mission: Mission, source: str, *_: object, **__: object) -> None:
        sources.append(source)
        raise Refusal("enough")

    monkeypatch.setattr(run, "programs", plan)
    for mission in ("field", "turtlebot3_pair"):
        assert refused(capsys, ["run", mission]) == "formation: enough\n"
    assert sources == ["field/desk/mission.toml", "turtlebot3_pair"]


def test_page_port_in_use_is_refused(capsys: Capsys) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        assert refused(capsys, ["run", "--page", where]) == (
            f"formation: --page {where}: Address already in use: {IN_USE}\n"
        )
