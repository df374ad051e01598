"""`formation new`: its missions, output and refusals."""

from __future__ import annotations

import json
import shlex
from itertools import combinations
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.deploy.mission_files.new import MIN_SLOT_RADII, PROFILES
from formation.mission.file import load
from formation.simulation.simulate import simulate
from formation.slots.shapes import SHAPES
from formation.stability.analysis import analyse
from formation.stability.crowding import rows
from tests.campaigns.safety.missions import faults, made
from tests.support.examples import slow
from tests.unit.deploy.commands import Capsys, output_of, refused

SAMPLE = (7, *slow(3, 4, 16, 50))
"""Numbers of robots; `python -m tests.campaigns.safety missions` tries all."""


@pytest.fixture(autouse=True)
def _in_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("robots", SAMPLE)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("profile", ["turtlebot3_burger", *slow("paper")])
def test_new_mission_passes_check_and_converges(shape: str, robots: int, profile: str) -> None:
    mission = made(shape, robots, profile)
    by_chance = simulate(mission, runs=5)
    assert not list(faults(mission, by_chance))
    assert by_chance.nearest.min() > 0.0
    own = simulate(made(shape, robots, profile, avoid=False))
    assert own.converged.all()
    assert own.nearest.min() > 0.0


@pytest.mark.parametrize("shape", ["wedge", *slow(*(one for one in SHAPES if one != "wedge"))])
def test_printed_next_commands_work(shape: str, capsys: Capsys) -> None:
    out = output_of(capsys, ["new", shape, "--robots", "7", "--out", "it's mine.toml"])
    lines = [shlex.split(line) for line in out.splitlines() if line.startswith("  formation ")]
    assert [line[1:3] for line in lines] == [[do, "it's mine.toml"] for do in ("check", "simulate", "run")]
    assert main(lines[0][1:]) == 0
    assert "converged        100 of 100" in output_of(capsys, lines[1][1:])


@pytest.mark.parametrize("profile", ["paper", *slow("turtlebot3_burger")])
@pytest.mark.parametrize("shape", SHAPES)
def test_least_spacing_leaves_room_at_starts_and_slots(shape: str, profile: str) -> None:
    radius = PROFILES[profile].radius
    least = f"{MIN_SLOT_RADII * radius:.4g}"
    assert main(["new", shape, "--robots", "23", "--robot", profile, "--spacing", least, "--avoid"]) == 0
    mission = load(f"{shape}_23.toml")
    starts = {name: mission.robots[name].start.position for name in mission.followers}
    assert all(abs(start - mission.slot(name)) <= 0.5 for name, start in starts.items())
    assert min(abs(a - b) for a, b in combinations(starts.values(), 2)) > 2.4 * radius
    found = analyse(mission)
    assert found.problems == ()
    assert found.warnings == tuple(rows(mission)), "no robot can pass between such slots"
    assert simulate(mission).converged.all()


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("shape", SHAPES)
def test_default_spacing_lets_a_robot_pass_between_slots(shape: str, profile: str) -> None:
    assert main(["new", shape, "--robots", "7", "--robot", profile]) == 0
    assert list(rows(load(f"{shape}_7.toml"))) == []


def test_recorded_command_recreates_the_same_file(capsys: Capsys) -> None:
    requested = ["polygon", "--robots", "9", "--corners", "3", "--spacing", "0.7", "--robot", "paper"]
    assert main(["new", *requested, "--out", "one.toml"]) == 0
    first = Path("one.toml").read_text(encoding="utf-8")
    (line,) = [line for line in first.splitlines() if line.startswith("#   formation new")]
    assert main([*shlex.split(line)[2:], "--out", "two.toml"]) == 0
    assert Path("two.toml").read_text(encoding="utf-8") == first
    assert capsys.readouterr().err == ""


def test_existing_file_is_overwritten_only_with_force(capsys: Capsys) -> None:
    Path("mine.toml").write_text("precious", encoding="utf-8")
    command = ["new", "line", "--robots", "4", "--out", "mine.toml"]
    assert "--force" in refused(capsys, command)
    assert Path("mine.toml").read_text(encoding="utf-8") == "precious"
    assert main([*command, "--force"]) == 0
    assert load("mine.toml").name == "line-4"


@pytest.mark.parametrize(
    ("requested", "message"),
    [
        ("star --robots 7", "line"),
        ("line", "--robots"),
        ("line --robots 1", "at least 2 and at most 200"),
        ("line --robots 201", "at least 2 and at most 200"),
        ("polygon --robots 2", "at least 3"),
        ("polygon --robots 5 --corners 6", "from 3 to the number of robots, 5"),
        ("circle --robots 5 --corners 4", "only a polygon"),
        ("line --robots 5 --spacing 0.47", "at least 0.4725 m"),
        ("line --robots 5 --spacing nan", "above 0 and at most 100"),
        ("line --robots 5 --robot roomba", "turtlebot3_burger"),
        ("line --robots 5 --out mission.yaml", "must end in .toml"),
        (f"line --robots 5 --out {'long' * 75}.toml", "long.toml: File name too long"),
        (f"line --robots 5 --out {'long' * 75}/a.toml", "File name too long"),
        (f"line --robots 5 --out {__file__}/mission.toml", "test_new.py is a file, and no folder"),
    ],
)
def test_impossible_request_is_refused_and_writes_nothing(
    requested: str, message: str, capsys: Capsys
) -> None:
    err = refused(capsys, ["new", *requested.split()])
    assert message in err.splitlines()[-1]
    assert not list(Path().iterdir())


def test_missing_folders_of_a_mission_are_made(capsys: Capsys) -> None:
    output_of(capsys, ["new", "line", "--robots", "5", "--out", "new/folder/mission.toml"])
    assert load("new/folder/mission.toml").name == "line-5"


def test_json_output_describes_written_mission(capsys: Capsys) -> None:
    assert main(["new", "grid", "--robots", "12", "--json"]) == 0
    mission = load("grid_12.toml")
    assert mission.names == ("leader", *(f"robot{i}" for i in range(1, 13)))
    assert json.loads(capsys.readouterr().out) == {
        "file": "grid_12.toml", "mission": "grid-12", "shape": "grid", "robots": 12, "spacing": 0.9,
        "profile": "turtlebot3_burger", "edges": sum(map(len, mission.graph.neighbours)), "depth": 4,
    }  # fmt: skip


def test_help_names_every_shape_and_an_example(capsys: Capsys) -> None:
    result = output_of(capsys, ["new", "--help"])
    assert all(shape in result for shape in SHAPES)
    assert "formation new wedge --robots 7" in result
