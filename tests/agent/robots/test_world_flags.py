"""Which world robots are in, on the command line; what cannot be is one line."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from agent.robots import __main__ as robots
from agent.robots.flags import add_world_flags, unfit, world_flags


def read(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_world_flags(parser)
    return parser.parse_args(words)


def test_without_a_flag_robots_are_as_they_were() -> None:
    assert world_flags(read()) == ()
    assert unfit(read()) is None


def test_flags_are_handed_on_as_they_were_said(tmp_path: Path) -> None:
    words = ("--world", "mujoco", "--picture", str(tmp_path / "end.png"))
    assert world_flags(read(*words)) == words


def test_a_picture_needs_the_physics_world_and_a_folder(tmp_path: Path) -> None:
    assert unfit(read("--picture", "end.png")) == "--picture: needs --world mujoco"
    nowhere = str(tmp_path / "none" / "end.png")
    assert "there is no folder" in str(unfit(read("--world", "mujoco", "--picture", nowhere)))


def test_a_picture_needs_something_that_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("agent.robots.flags.find_library", lambda _: None)
    assert "apt install libegl1" in str(unfit(read("--world", "mujoco", "--picture", "end.png")))


def test_the_missing_extra_is_named_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(robots, "find_spec", lambda _: None)
    assert robots.main(["six_robots", "--world", "mujoco"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "pip install 'formation[physics]'" in said


def test_a_physics_world_cannot_have_some_of_the_robots_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert robots.main(["six_robots", "--world", "mujoco", "--robot", "robot2"]) == 2
    assert "leave out --robot" in capsys.readouterr().err
