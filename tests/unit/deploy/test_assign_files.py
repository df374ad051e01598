"""`formation assign`: what it reads and writes, what it leaves alone, and what it refuses."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.mission.file import load, read, shipped
from tests.unit.deploy.assigning import assigned, shuffled


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_line_ends_stay_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.toml").write_bytes(read("six_robots")[0].replace("\n", "\r\n").encode())
    assigned(capsys, "mine.toml")
    raw = Path("mine.toml").read_bytes()
    assert b"fallback_neighbours" in raw
    assert raw.count(b"\n") == raw.count(b"\r\n")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("nowhere.toml", "no such file"),
        ("six_robots", "--out FILE"),
        ("six_robots --out mine.yaml", "must end in .toml"),
        ("six_robots --out there.toml", "--force"),
        ("six_robots --dry-run --shape star", "hexagon, wedge"),
        ("six_robots --dry-run --least time", "total"),
        ("six_robots --dry-run --positions none.json", "No such file"),
        ("six_robots --dry-run --positions there.toml", "not JSON"),
        ("six_robots --dry-run --positions list.json", "must be an object"),
        ("six_robots --dry-run --positions who.json", "unknown robot robot9; known: robot1, robot2"),
        ("six_robots --dry-run --positions point.json", "robot2 = [1, True]: must be [x, y]"),
        ("six_robots --dry-run --positions deep.json", "a thousand deep"),
        ("six_robots --dry-run --positions far.json", "two numbers from -100000 to 100000 in metres"),
        ("six_robots --dry-run --positions farther.json", "robot2 = [1, 10000000000"),
        (f"six_robots --out {'long' * 75}.toml", "long.toml: File name too long"),
    ],
)
def test_what_cannot_be_is_one_line_that_says_what_can(
    arguments: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("there.toml").write_text("precious", encoding="utf-8")
    Path("list.json").write_text("[1, 2]", encoding="utf-8")
    Path("who.json").write_text('{"robot9": [1, 2]}', encoding="utf-8")
    Path("point.json").write_text('{"robot2": [1, true]}', encoding="utf-8")
    Path("deep.json").write_text("[" * 100_000, encoding="utf-8")
    Path("far.json").write_text('{"robot2": [1, -1.7e308]}', encoding="utf-8")
    Path("farther.json").write_text('{"robot2": [1, 1%s]}' % ("0" * 400), encoding="utf-8")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    assert main(["assign", *arguments.split()]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err.splitlines()[-1]
    assert {path: path.read_bytes() for path in Path().iterdir()} == before


def test_a_shape_in_one_line_is_changed_in_place(capsys: pytest.CaptureFixture[str]) -> None:
    inline = read("turtlebot3_pair")[0].replace("[shapes.triangle]", "[shapes]\ntriangle = { #")
    inline = inline.replace("{ # ", "{ robot1 = [-0.433013, -0.25], robot2 = [-0.433013, 0.25] } # ")
    inline = re.sub(r"^robot[12] = .*\n", "", inline, flags=re.MULTILINE)
    Path("mine.toml").write_text(inline, encoding="utf-8")
    assigned(capsys, "mine.toml")
    assert re.findall("#.*", Path("mine.toml").read_text(encoding="utf-8")) == re.findall("#.*", inline)
    assert load("mine.toml").slot("robot1") == load("turtlebot3_pair").slot("robot1")


@pytest.mark.parametrize(
    "command",
    [
        "assign missions/six_robots.toml",
        "assign ../{here}/missions/six_robots.toml --positions now.json",
        "assign link.toml",
        "assign patrol --out missions/six_robots.toml --force",
        "assign patrol --out link.toml --force",
        "new line --robots 4 --out link.toml --force",
    ],
)
def test_shipped_mission_is_never_overwritten(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(shipped()["six_robots"].parent, "missions")
    monkeypatch.setattr("formation.mission.file.files", lambda _: Path())
    Path("link.toml").symlink_to("missions/six_robots.toml")
    Path("now.json").write_text('{"robot2": [-2, -1]}', encoding="utf-8")
    text = Path("link.toml").read_bytes()
    assert main(command.format(here=Path.cwd().name).split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "is shipped, and stays as it is" in err
    assert Path("link.toml").read_bytes() == text


def test_assign_keeps_symbolic_link_and_file_mode(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path(shuffled()).rename("real.toml")
    Path("real.toml").chmod(0o640)
    Path("link.toml").symlink_to("real.toml")
    assigned(capsys, "link.toml")
    assert Path("link.toml").is_symlink()
    assert Path("real.toml").stat().st_mode & 0o777 == 0o640
