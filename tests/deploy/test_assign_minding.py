"""`formation assign`: who minded whom goes along with the slots."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from formation.mission import Mission
from formation.mission_file import load, read
from formation.slots.shapes import SHAPES
from tests.deploy.assigning import assigned, shuffled


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def minding(mission: Mission) -> set[tuple[complex, complex]]:
    """Which slots mind which."""
    return {
        (mission.slot(robot), mission.slot(other))
        for robot in mission.followers
        for other in mission.minded(robot)
    }


@pytest.mark.parametrize("graph", ["new", "keep"])
@pytest.mark.parametrize("shape", SHAPES)
def test_slots_that_minded_each_other_do_so_in_whoever_s_hands_they_are(
    shape: str, graph: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = load(shuffled(shape, 16))
    found = assigned(capsys, "mine.toml", "--graph", graph)
    after = load("mine.toml")
    assert any(name != robot["takes_slot_of"] for name, robot in found["robots"].items())
    assert minding(before) <= minding(after)


def test_slots_whose_robots_measured_each_other_mind_each_other_when_the_graph_is_another(
    capsys: pytest.CaptureFixture[str],
) -> None:
    own = re.sub('mind = "all".*', "", read("six_robots")[0])
    Path("mine.toml").write_text(
        own.replace('["robot1"]\n', '["robot1"]\nmind = ["robot6"]\n'), encoding="utf-8"
    )
    before = load("mine.toml")
    assigned(capsys, "mine.toml")
    after = load("mine.toml")
    assert after.graph != before.graph
    assert minding(before) <= minding(after)


@pytest.mark.parametrize("default", ['"all"', '["robot1", "robot2"]', "[]"])
@pytest.mark.parametrize("own", ['"all"', "'all'", '["robot3"]', "[]"])
def test_a_mind_of_its_own_goes_along_with_the_slot_whatever_all_others_have(
    own: str, default: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = re.sub(r"mind = \S+", f"mind = {default}", read("patrol")[0], count=1)
    text = text.replace("[robots.robot1]\n", f"[robots.robot1]\nmind = {own} # mine\n")
    text = text.replace("robot1 = [", "robotx = [").replace("robot3 = [", "robot1 = [")
    Path("mine.toml").write_text(text.replace("robotx = [", "robot3 = ["), encoding="utf-8")
    before = load("mine.toml")
    found = assigned(capsys, "mine.toml", "--graph", "keep")
    after = load("mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot3"
    assert minding(before) == minding(after)
