"""`formation assign`, as it is used."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.mission.file import load, read
from formation.mission.model import Mission
from formation.slots.shapes import SHAPES
from tests.unit.deploy.assigning import assigned, shuffled


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def distances(mission: Mission) -> list[float]:
    """From each start to the slot, centre to centre [m]."""
    ahead = mission.robots[mission.followers[0]].control_point_offset
    return [
        abs(mission.slot(name) - ahead - mission.robots[name].start.position) for name in mission.followers
    ]


@pytest.mark.parametrize("least", ["total", "longest"])
@pytest.mark.parametrize("shape", SHAPES)
def test_robot_takes_the_slot_near_its_start(
    shape: str, least: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mission = shuffled(shape)
    before = sum(distances(load(mission)))
    found = assigned(capsys, mission, "--least", least)
    after = load(mission)
    assert sum(distances(after)) == pytest.approx(found["distance"]["now"]["total"])
    assert before == pytest.approx(found["distance"]["before"]["total"])
    assert max(distances(after)) < 0.2 < 0.2 * before
    assert main(["check", mission]) == 0


def test_assigning_again_changes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    mission = shuffled()
    assigned(capsys, mission)
    text = Path(mission).read_bytes()
    assert main(["assign", mission]) == 0
    assert "is so already" in capsys.readouterr().out
    assert Path(mission).read_bytes() == text


@pytest.mark.parametrize("robots", [3, 8, 50])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_new_mission_is_assigned_already(
    shape: str, robots: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", shape, "--robots", str(robots), "--out", "mine.toml"]) == 0
    text = Path("mine.toml").read_bytes()
    assigned(capsys, "mine.toml")
    assert Path("mine.toml").read_bytes() == text


def test_comments_order_and_all_other_values_stay(capsys: pytest.CaptureFixture[str]) -> None:
    assigned(capsys, "six_robots", "--out", "mine.toml")
    before, after = read("six_robots")[0], Path("mine.toml").read_text(encoding="utf-8")
    differing = {
        line.partition("=")[0].strip() for line in set(before.splitlines()) ^ set(after.splitlines())
    }
    assert differing == {"neighbours", "fallback_neighbours"}
    assert re.findall("#.*", before) == re.findall("#.*", after)
    assert list(load("mine.toml").robots) == list(load("six_robots").robots)


def test_slot_is_assigned_in_every_shape(capsys: pytest.CaptureFixture[str]) -> None:
    swapped = read("patrol")[0].replace("robot1 = [", "robotx = [").replace("robot3 = [", "robot1 = [")
    Path("mine.toml").write_text(swapped.replace("robotx = [", "robot3 = ["), encoding="utf-8")
    found = assigned(capsys, "mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot3"
    own, mine = load("patrol"), load("mine.toml")
    assert mine.shapes == own.shapes
    assert mine.graph == own.graph


def test_with_keep_slots_measure_each_other_as_they_did(capsys: pytest.CaptureFixture[str]) -> None:
    text = read("two_chains")[0]
    text = text.replace("left1 = [-0.6, 0.4]", "x = [-0.6, 0.4]").replace("left6 = [-3.6,", "left1 = [-3.6,")
    Path("mine.toml").write_text(text.replace("x = [", "left6 = ["), encoding="utf-8")
    assigned(capsys, "mine.toml", "--graph", "keep")
    after = load("mine.toml")
    assert after.slot("left1") == complex(-0.6, 0.4)
    assert after.robots["left1"].neighbours == ("left5",)  # as that slot did
    assert after.robots["left6"].neighbours == ("leader",)


def test_printed_command_can_be_pasted_for_any_filename(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["assign", "six_robots", "--out", "it's mine.toml"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  formation ")]
    assert main(shlex.split(line)[1:]) == 0


def test_a_dry_run_shows_the_ways_and_writes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    mission = shuffled()
    text = Path(mission).read_bytes()
    assert main(["assign", mission, "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "nothing was written" in out
    assert all(f"\n  {name} " in out for name in load(mission).followers)
    assert "in all" in out
    assert "longest" in out
    assert Path(mission).read_bytes() == text


def test_assignment_can_begin_at_given_positions(
    capsys: pytest.CaptureFixture[str],
) -> None:
    first = load("turtlebot3_pair")
    at = {
        name: [*first.shapes["triangle"][other]]
        for name, other in (("robot1", "robot2"), ("robot2", "robot1"))
    }
    Path("now.json").write_text(json.dumps(at), encoding="utf-8")
    found = assigned(capsys, "turtlebot3_pair", "--positions", "now.json", "--out", "mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot2"
    assert found["distance"]["now"]["longest"] == pytest.approx(0.05)  # the control point is that far ahead
    assert load("mine.toml").robots["robot1"].start == first.robots["robot1"].start


def test_a_leader_elsewhere_takes_the_slots_along(capsys: pytest.CaptureFixture[str]) -> None:
    first = load("turtlebot3_pair")
    at = {name: [x + 7.0, y - 2.0] for name, (x, y) in first.shapes["triangle"].items()}
    Path("now.json").write_text(json.dumps({**at, "leader": [7.0, -2.0]}), encoding="utf-8")
    found = assigned(capsys, "turtlebot3_pair", "--positions", "now.json", "--dry-run")
    assert found["distance"]["before"]["longest"] == pytest.approx(0.05)


def test_turning_slots_follow_first_heading_of_leader(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["new", "wedge", "--robots", "7", "--out", "mine.toml"]) == 0
    text = Path("mine.toml").read_text(encoding="utf-8")
    text = text.replace("\nheading_deg = 0\n", "\nheading_deg = 90\n")
    Path("mine.toml").write_text(text, encoding="utf-8")
    mission = load("mine.toml")
    turned = {name: 1j * (mission.slot(name) - 0.05) for name in mission.followers}
    at = {name: [centre.real, centre.imag] for name, centre in turned.items()}
    Path("now.json").write_text(json.dumps(at), encoding="utf-8")
    found = assigned(capsys, "mine.toml", "--positions", "now.json", "--dry-run")
    assert found["distance"]["before"]["longest"] == pytest.approx(0.0, abs=1e-9)


def test_another_shape_can_be_the_one_to_go_into(capsys: pytest.CaptureFixture[str]) -> None:
    one = assigned(capsys, "patrol", "--dry-run")
    other = assigned(capsys, "patrol", "--dry-run", "--shape", "line")
    assert one["distance"]["before"]["total"] != other["distance"]["before"]["total"]
