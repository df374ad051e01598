"""`formation assign`: the robots to avoid go along with the slots."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from formation.mission.file import load, read
from formation.mission.model import Mission
from formation.slots.shapes import SHAPES
from tests.unit.deploy.assigning import assigned, shuffled


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def avoiding(mission: Mission) -> set[tuple[complex, complex]]:
    """Which slots avoid which."""
    return {
        (mission.slot(robot), mission.slot(other))
        for robot in mission.followers
        for other in mission.avoided_by(robot)
    }


@pytest.mark.parametrize("graph", ["new", "keep"])
@pytest.mark.parametrize("shape", SHAPES)
def test_slots_keep_avoiding_each_other_after_assignment(
    shape: str, graph: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = load(shuffled(shape, 16))
    found = assigned(capsys, "mine.toml", "--graph", graph)
    after = load("mine.toml")
    assert any(name != robot["takes_slot_of"] for name, robot in found["robots"].items())
    assert avoiding(before) <= avoiding(after)


def test_slots_measured_before_graph_change_are_avoided_afterwards(
    capsys: pytest.CaptureFixture[str],
) -> None:
    own = re.sub('avoid = "all".*', "", read("six_robots")[0])
    Path("mine.toml").write_text(
        own.replace('["robot1"]\n', '["robot1"]\navoid = ["robot6"]\n'), encoding="utf-8"
    )
    before = load("mine.toml")
    assigned(capsys, "mine.toml")
    after = load("mine.toml")
    assert after.graph != before.graph
    assert avoiding(before) <= avoiding(after)


@pytest.mark.parametrize("default", ['"all"', '["robot1", "robot2"]', "[]"])
@pytest.mark.parametrize("own", ['"all"', "'all'", '["robot3"]', "[]"])
def test_avoidance_list_of_robot_moves_with_its_slot(
    own: str, default: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = re.sub(r"avoid = \S+", f"avoid = {default}", read("patrol")[0], count=1)
    text = text.replace("[robots.robot1]\n", f"[robots.robot1]\navoid = {own} # mine\n")
    text = text.replace("robot1 = [", "robotx = [").replace("robot3 = [", "robot1 = [")
    Path("mine.toml").write_text(text.replace("robotx = [", "robot3 = ["), encoding="utf-8")
    before = load("mine.toml")
    found = assigned(capsys, "mine.toml", "--graph", "keep")
    after = load("mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot3"
    assert avoiding(before) == avoiding(after)
