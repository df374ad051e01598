"""Which world robots are in, on the command line; what cannot be is one line."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import pytest

from formation.agent.simulated import __main__ as robots
from formation.agent.simulated.flags import add_world_flags, unfit, world_flags


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


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("mission.toml", "must end in .png"),
        ("end.jpg", "must end in .png"),
        ("folder.png", "is a folder; name a file"),
        ("text.png", "is there already, and is no picture; name another file"),
        ("pipe.png", "is there already, and is no picture; name another file"),
        (f"{'long' * 75}.png", "File name too long"),
        ("old.png", None),
        ("nothing.PNG", None),
        ("new.png", None),
    ],
)
def test_picture_replaces_only_an_older_picture(
    name: str, says: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    (tmp_path / "mission.toml").write_text("precious")
    (tmp_path / "text.png").write_text("precious")
    (tmp_path / "old.png").write_bytes(b"\x89PNG\r\n\x1a\n and so on")
    (tmp_path / "nothing.PNG").touch()
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    picture = str(tmp_path / name)
    wrong = unfit(read("--world", "mujoco", "--picture", picture))
    assert wrong == (None if says is None else f"--picture {picture}: {says}")


def test_a_picture_needs_something_that_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("formation.agent.simulated.flags.find_library", lambda _: None)
    assert "apt install libegl1" in str(unfit(read("--world", "mujoco", "--picture", "end.png")))


def test_the_missing_extra_is_named_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(robots, "find_spec", lambda _: None)
    assert robots.main(["six_robots", "--world", "mujoco"]) == 2
    result = capsys.readouterr().err
    assert result.count("\n") == 1
    assert "pip install '.[physics]'" in result


def test_a_physics_world_cannot_have_some_of_the_robots_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert robots.main(["six_robots", "--world", "mujoco", "--robot", "robot2"]) == 2
    assert "leave out --robot" in capsys.readouterr().err
