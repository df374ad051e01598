"""`formation order` on the command line: refusals before any request is sent, and the JSON output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main
from formation.mission.file import load

UNREACHABLE = ("--timeout", "0.1", "--json", "-e", "tcp/127.0.0.1:9")
TURN = "[[route]]\nspeed = 0.1\nheading_deg = 90\nduration = 5\n[[route]]\nradius = 1.0\nspeed = 0.1\n"


def unanswered(capsys: pytest.CaptureFixture[str], mission: str, *words: str) -> dict[str, Any]:
    """JSON output for an order that reaches no process."""
    assert main(["order", mission, *words, *UNREACHABLE]) == 1
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def test_unanswered_stop_lists_all_robots_as_missing(capsys: pytest.CaptureFixture[str]) -> None:
    result = unanswered(capsys, "turtlebot3_pair", "stop")
    assert result.pop("id")
    assert result.pop("at") > 0.0
    assert result.pop("mission") == load("turtlebot3_pair").tag
    assert result == {
        "do": "stop", "leader": None, "acknowledged": [], "refused": [],
        "missing": ["leader", "robot1", "robot2"], "standby": [], "unreached": [],
        "advice": ["robot1, robot2 may still drive: use the robot's own switch"],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("shape wedge", {"shape": "wedge"}),
        ("rotate -30", {"degrees": -30.0}),
        ("rotate -.5e1", {"degrees": -5.0}),
        ("scale 1.5", {"factor": 1.5}),
        ("speed 0.1 -90", {"speed": 0.1, "degrees": -90.0}),
        ("tune k_p=3 k_i=0.5", {"k_p": 3.0, "k_i": 0.5}),
        ("tune k_i=1e-1", {"k_i": 0.1}),
        ("route six_robots", {"legs": [{"speed": 0.2, "heading_deg": 30.0}]}),
    ],
)
def test_team_orders_go_only_to_leader(
    words: str, what: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    result = unanswered(capsys, "six_robots", *words.split())
    assert result["missing"] == ["robot1"]
    assert {**result, "do": words.split(maxsplit=1)[0], **what} == result


@pytest.mark.parametrize("do", ["stop", "hold", "run", "release"])
def test_mode_orders_go_to_every_robot(do: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert unanswered(capsys, "six_robots", do)["missing"] == list(load("six_robots").names)


def test_flags_are_accepted_at_any_position(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["order", *UNREACHABLE[:2], "six_robots", "--json", "rotate", *UNREACHABLE[3:], "-30"]) == 1
    assert json.loads(capsys.readouterr().out)["degrees"] == -30.0


def test_route_is_read_from_file_without_mission(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "turn.toml").write_text(TURN)
    legs = unanswered(capsys, "six_robots", "route", str(tmp_path / "turn.toml"))["legs"]
    assert legs[0] == {"speed": 0.1, "heading_deg": 90.0, "duration": 5.0}
    assert (legs[1]["radius"], legs[1]["turn"]) == (1.0, "left")


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ("", "route is missing; legal here: route"),
        ("route = []", "route = []: should"),
        (TURN + "colour = 1\n", "unknown key route.1.colour; legal here: radius, speed, heading_deg, turn"),
        ("speed = 1\n" + TURN, "unknown key speed; legal here: route"),
        (TURN.replace("0.1", "-0.1"), "route.0.speed = -0.1: should be greater than or equal to 0"),
        ("[[route]", "not valid TOML"),
        ("[robots]\n" + TURN, "name is missing; legal here: name, leader"),
        ("[[route]]\nspeed = 0.1\nheading_deg = 0.33\nduration = 12.34\n" * 400, "too long, at most 16384"),
    ],
)
def test_bad_route_file_is_refused_in_one_line(
    text: str, output: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "route.toml"
    file.write_text(text)
    assert main(["order", "six_robots", "route", str(file)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert output in error


@pytest.mark.parametrize(
    ("words", "output"),
    [
        ("stop -e nonsense", "--connect 'nonsense'"),
        ("", "an order is missing: must be one of stop, release, hold, run, shape, rotate, scale"),
        ("fly", "order 'fly': must be one of stop, release, hold"),
        ("shape", "shape: must be one of hexagon, wedge"),
        ("shape circle", "shape 'circle': must be one of hexagon, wedge"),
        ("stop wedge", "stop is for all robots and takes nothing more; here: wedge. All robots: formation"),
        (
            "rotate",
            "rotate takes DEG (turn the shape, counter-clockwise from how it is drawn); here: nothing",
        ),
        ("rotate left", "rotate DEG: 'left': must be a number"),
        ("rotate 4000", "degrees = 4000.0: must be less than or equal to 3600"),
        ("rotate nan", "degrees = nan: must be a finite number"),
        ("scale 0", "factor = 0.0: must be greater than or equal to 0.001"),
        ("tune", "tune takes gains as k_p=2 k_i=1; those that can be tuned are k_p and k_i"),
        ("tune 3", "'3': must be a gain as k_p=2"),
        ("tune kp=3", "tune: no gain 'kp' can be tuned; those that can are k_p and k_i"),
        ("tune k_p=3 k_p=4", "tune: k_p is given twice"),
        ("tune k_p=fast", "tune k_p: 'fast': must be a number"),
        ("tune k_p=-1", "tune: k_p = -1.0: must be greater than or equal to 0.001"),
        ("tune k_p=60 k_i=1", "k_p = 60: overshoots at robot2's 20 Hz, eigenvalue"),
        (
            "speed 0.1",
            "speed takes V and HEADING (straight on from here, V m/s, towards HEADING degrees); here: 0.1",
        ),
        ("speed -0.1 0", "speed = -0.1: must be greater than or equal to 0"),
        ("route nothing.toml", "nothing.toml: no such file"),
    ],
)
def test_bad_order_is_refused_in_one_line(
    words: str, output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["order", "six_robots", *words.split()]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert output in error
