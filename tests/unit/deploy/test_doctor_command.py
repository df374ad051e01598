"""What the doctor says to people, and what it refuses to examine."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.deploy.doctor.cli import COLOUR, EXAMINATIONS, PLAIN, style, words
from formation.deploy.doctor.facts import examine
from formation.mission.file import shipped
from tests.unit.deploy.examined import HEALTHY


def test_the_report_fits_eighty_columns_and_names_robot_sentence_and_remedy() -> None:
    ill = replace(
        HEALTHY, routed=False, listeners=(), installed_differs="/opt/formation/current/mission.toml"
    )
    result = words({"robot1": examine(EXAMINATIONS, ill), "robot2": examine(EXAMINATIONS, HEALTHY)})
    assert max(map(len, result.splitlines())) <= 80
    assert result.splitlines()[0] == "robot1"
    assert "  ✗ robot        nothing listens to cmd_vel: the bridge has lost its route, or\n" in result
    assert "                 → restart the bring-up and the bridge together\n" in result
    assert result.splitlines()[-1] == "2 things are wrong: robot1"
    assert words({"robot2": examine(EXAMINATIONS, HEALTHY)}).endswith("\nhealthy: nothing is wrong")


class Terminal(io.StringIO):
    """A terminal that shows colours."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def test_no_color_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert style(Terminal()) == COLOUR
    monkeypatch.setenv("NO_COLOR", "")
    assert style(Terminal()) == COLOUR
    monkeypatch.setenv("NO_COLOR", "1")
    assert style(Terminal()) == PLAIN


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--prefix", "/nowhere"], "MISSION is missing, and none is installed here"),
        (["turtlebot3_pair", "--robot", "robot9"], "--robot 'robot9': must be a follower of turtlebot3-pair"),
        (["turtlebot3_pair", "--robot", "leader"], "--robot 'leader': must be a follower"),
        (["turtlebot3_pair", "--robot", "robot1", "--robot-connect", "there"], "'there': must be PROTOCOL/"),
        (["no_such_mission"], "no such file"),
        (["turtlebot3_pair", "-c", "/nowhere.json5"], "--config '/nowhere.json5'"),
    ],
)
def test_what_cannot_be_examined_is_refused_in_a_sentence(
    words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", *words]) == 2
    assert why in capsys.readouterr().err


def test_installation_without_configuration_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "current"
    home.mkdir()
    (home / "mission.toml").write_bytes(shipped()["turtlebot3_pair"].read_bytes())
    (home / "VERSION.json").write_text('{"robot": "robot1"}')
    assert main(["doctor", "--prefix", str(tmp_path)]) == 2
    assert "zenoh.json5 is missing: install this robot's bundle again" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "whose"), [("leader", "leader's"), ("deputy", "standby's")])
def test_doctor_on_leader_machine_asks_for_mission(
    name: str, whose: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "current"
    home.mkdir()
    (home / "mission.toml").write_bytes(shipped()["patrol"].read_bytes())
    (home / "VERSION.json").write_text(json.dumps({"robot": name}))
    assert main(["doctor", "--prefix", str(tmp_path)]) == 2
    assert f"this is the {whose} machine: say MISSION" in capsys.readouterr().err
