"""Warnings of missions with robots that must see each other (`formation.stability.landmarks`)."""

from __future__ import annotations

import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.stability.landmarks import warnings
from tests.support.missions import with_robots
from tests.support.seeing import hexagon

SEES = {"measurement": "scan", "scanner": "required"}


@pytest.mark.parametrize("mission", [hexagon(), load("posts")], ids=["one by odometry", "without sight"])
def test_missions_that_need_no_landmark_have_no_warning(mission: Mission) -> None:
    assert list(warnings(mission)) == []


def test_several_robots_without_landmark_drift_apart() -> None:
    (warning,) = warnings(with_robots("posts", **SEES))
    assert warning.startswith("robot1, robot2: have no neighbour that is nearer to the leader")


def test_landmark_out_of_range_is_named() -> None:
    mission = with_robots("six_robots", **SEES)
    near = mission.simulated_scanner.model_copy(update={"range_max": 0.9})
    found = list(warnings(mission.changed(simulated_scanner=near)))
    assert found[0] == (
        "robot3: in shape hexagon its nearest neighbour to be seen is 1.00 m away;"
        " the simulated scanner measures 0.9 m"
    )


@pytest.mark.parametrize("name", ["posts", "six_robots"])
def test_landmarks_never_lead_in_a_circle(name: str) -> None:
    mission = with_robots(name, **SEES)
    done: set[str] = set()
    while left := [one for one in mission.followers if one not in done]:
        ready = [one for one in left if set(mission.landmarks_of(one)) <= done]
        assert ready
        done.update(ready)
