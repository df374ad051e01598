"""`formation stop` on the command line: which robots it asks, and what it prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main
from formation.deploy.order import DEFAULT_MISSION, mission_to_stop
from formation.deploy.refusal import Refusal
from formation.mission.file import DESK, MISSION_NAME, configuration_of, file_of, load, shipped

UNREACHABLE = ("--timeout", "0.1", "--json", "-e", "tcp/127.0.0.1:9")


def bundles(folder: Path, mission: str = "turtlebot3_pair") -> Path:
    """A folder as `formation deploy bundle` leaves it, without certificates."""
    (folder / DESK).mkdir(parents=True)
    (folder / DESK / MISSION_NAME).write_bytes(shipped()[mission].read_bytes())
    return folder


def unanswered(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    """JSON output for a stop that reaches no process."""
    assert main([*words, *UNREACHABLE]) == 1
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert report.pop("id")
    assert report.pop("at") > 0.0
    return report


def test_stop_prints_same_report_as_order_stop(capsys: pytest.CaptureFixture[str]) -> None:
    short = unanswered(capsys, "stop", "turtlebot3_pair")
    assert short == unanswered(capsys, "order", "turtlebot3_pair", "stop")
    assert short["missing"] == ["leader", "robot1", "robot2"]


def test_stop_without_mission_uses_default_or_bundles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert unanswered(capsys, "stop")["missing"] == list(load(DEFAULT_MISSION).names)
    assert main(["stop", *UNREACHABLE]) == 1
    assert "formation stop MISSION" in capsys.readouterr().err
    bundles(Path("field"))
    assert unanswered(capsys, "stop")["missing"] == ["leader", "robot1", "robot2"]
    monkeypatch.chdir("field")
    assert unanswered(capsys, "stop")["missing"] == ["leader", "robot1", "robot2"]


def test_stop_of_one_robot_is_refused_with_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stop", "six_robots", "robot2", "--timeout", "1"]) == 2
    error = capsys.readouterr().err
    assert "stop is for all robots and takes nothing more; here: robot2" in error
    assert "formation stop six_robots. One robot: on it, sudo systemctl stop formation-agent" in error


def test_several_bundle_folders_are_refused_by_name(tmp_path: Path) -> None:
    bundles(tmp_path / "east")
    bundles(tmp_path / "west")
    with pytest.raises(Refusal, match=r"formation stop .*east, or formation stop .*west"):
        mission_to_stop(tmp_path)


def test_link_to_a_bundle_folder_is_no_second_fleet(tmp_path: Path) -> None:
    """A stop must not be refused because of `latest`."""
    folder = bundles(tmp_path / "field_3")
    (tmp_path / "latest").symlink_to(folder.parent if folder.name == DESK else folder)
    assert Path(mission_to_stop(tmp_path)).resolve() == (tmp_path / "field_3").resolve()


def test_bundle_folder_is_accepted_as_mission(tmp_path: Path) -> None:
    folder = bundles(tmp_path / "six_robots")
    assert file_of(folder) == file_of(folder / DESK) == folder / DESK / MISSION_NAME
    assert load(folder) == load("turtlebot3_pair")
    assert configuration_of(folder, "operator") is None
    (folder / DESK / "operator.json5").touch()
    assert configuration_of(folder, "operator") == folder / DESK / "operator.json5"


def test_stop_reads_operator_configuration_in_bundle_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = bundles(tmp_path / "field")
    (folder / DESK / "operator.json5").write_text("{ nonsense", encoding="utf-8")
    assert main(["stop", str(folder), "--timeout", "0.1"]) == 2
    assert "operator.json5" in capsys.readouterr().err


@pytest.mark.parametrize("name", shipped())
def test_shipped_mission_loads_by_title(name: str) -> None:
    assert load(load(name).name) == load(name)


def test_file_takes_precedence_over_mission_title(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("six-robots").write_bytes(shipped()["turtlebot3_pair"].read_bytes())
    assert load("six-robots").name == "turtlebot3-pair"
