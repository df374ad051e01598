"""Mission files that somebody made to hurt who reads them: each is refused in one line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from formation.mission import file as mission_file
from formation.mission.file import (
    MAX_KEY_PARTS,
    MAX_MISSION_BYTES,
    MissionError,
    TomlError,
    load,
    loads,
    parse,
)

SIX = mission_file.read("six_robots")[0]
DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("k_p = 2.0", f"k_p = {DIGITS}", "a number of over 4300 digits"),
        ("k_p = 2.0", f"k_p = 0x{'f' * 5000}", "law.k_p = a number of over 4300 digits: should be"),
        ("k_p = 2.0", f"k_p = {'[' * 5000}", "lists or tables a thousand deep"),
        ("[law]", f"a{'.a' * 50_000} = 1\n[law]", f"a key of over {MAX_KEY_PARTS} parts"),
        ("[law]", "'=' . '#' . " * 50 + "a = 1\n[law]", "a key of over"),
        ("[law]", '"\\u001b[2J\\n" = 1\n[law]', "unknown key \\x1b[2J\\n; legal here"),
        ("[law]", "#" * MAX_MISSION_BYTES + "\n[law]", f"is longer than {MAX_MISSION_BYTES} bytes"),
        (
            "[simulation]",
            "[simulation]\nstep = 1e-300",
            "step = 1e-300: should be greater than or equal to 0.001",
        ),
        ("[simulation]", "[simulation]\nhorizon = 1e9 #", "less than or equal to 3600"),
    ],
)
def test_hostile_toml_is_refused_in_one_line(old: str, new: str, says: str) -> None:
    text = SIX.replace("horizon", "# horizon") if "horizon" in new else SIX
    assert old in text
    with pytest.raises(MissionError) as refusal:
        parse(text.replace(old, new, 1), "six.toml")
    assert says in str(refusal.value)
    assert str(refusal.value).startswith("six.toml: ")
    assert str(refusal.value).isprintable()


def test_dots_elsewhere_than_in_keys_do_not_count() -> None:
    prose, numbers, lines = "x." * 200, "1.5, " * 200, "y.\n" * 200
    text = f'# {"." * 200}\na = "{prose}"\nb = [{numbers}]\nc = """{lines}"""\n'
    assert loads(text)["b"] == [1.5] * 200
    key = ".".join("abcdefgh" * 4)
    assert loads(f"{key} = 1")
    with pytest.raises(TomlError):
        loads(f"{key}.a = 1")


def test_too_many_robots_are_refused() -> None:
    robots = "".join(f"[robots.r{i}]\nstart = {{x = {i}.0, y = 0.0}}\n" for i in range(600))
    with pytest.raises(MissionError, match="at most 500 items"):
        parse(f"{SIX}\n{robots}")


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_a_device_is_refused(path: str) -> None:
    with pytest.raises(MissionError, match=f"{path}: must be a file, is a pipe or a device"):
        load(path)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(MissionError, match="is a pipe or a device"):
        load(tmp_path / "pipe.toml")


def test_a_huge_file_is_not_read_to_its_end(tmp_path: Path) -> None:
    with (tmp_path / "huge.toml").open("wb") as file:
        file.truncate(50 * 10**9)
    with pytest.raises(MissionError, match=f"is longer than {MAX_MISSION_BYTES} bytes"):
        load(tmp_path / "huge.toml")


@pytest.mark.parametrize("name", ["a\0b", "\ud800.toml", "."])
def test_what_is_no_file_is_refused(name: str) -> None:
    with pytest.raises(MissionError, match="cannot be read"):
        load(name)
