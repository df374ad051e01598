"""`formation order` as it is typed: what is refused before anybody is asked, and what programs are told."""

from __future__ import annotations

import json

import pytest

from deploy.cli import main

NOBODY = ("--timeout", "0.3", "--json", "-e", "tcp/127.0.0.1:9")


def test_with_nobody_there_the_command_names_all_that_are_missing(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["order", "turtlebot3_pair", "stop", *NOBODY])
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 1
    assert result == {"do": "stop", "robots": {}, "missing": ["leader", "robot1", "robot2"]}


def test_a_shape_is_asked_of_the_leader_alone(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["order", "six_robots", "shape", "wedge", *NOBODY])
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 1
    assert result == {"do": "shape", "shape": "wedge", "robots": {}, "missing": ["robot1"]}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["stop", "-e", "nonsense"], "--connect 'nonsense'"),
        (["shape"], "shape: must be one of hexagon, wedge"),
        (["shape", "circle"], "shape 'circle': must be one of hexagon, wedge"),
        (["stop", "wedge"], "stop: takes no shape"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["order", "six_robots", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
