"""Robots get out of each other's way: production cores, a fake clock, a network in memory."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest

from agent.commander import AT_REST
from agent.core import Agent
from formation.legs import Straight
from formation.mission import Mission
from formation.mission_file import load
from formation.topics import POSITION
from tests.agent.fleet import Fleet
from tests.agent.missions import team
from tests.formation import scenarios

SIX = load("six_robots")
CROSSING = scenarios.exchanged(SIX)
"""In which everybody has to pass somebody, and minds all."""
FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
"""One behind the other."""
PATROL = load("patrol").model_copy(update={"together": None})


def changed(mission: Mission, **robots: Any) -> Mission:
    """The same with other robots."""
    changed = {name: one.model_copy(update=robots) for name, one in mission.robots.items()}
    return mission.model_copy(update={"robots": changed})


LONERS = changed(SIX, mind=())
"""Who mind nobody but those they measure."""


def room(fleet: Fleet, seconds: float) -> float:
    """How near two bodies come to each other [m]."""
    least = float("inf")
    for _ in range(round(seconds / 0.05)):
        fleet.run(0.05)
        fleet.points()  # has all be where they are by now
        robots = fleet.world._hosted
        for one, other in combinations(fleet.mission.followers, 2):
            radii = fleet.mission.robots[one].radius + fleet.mission.robots[other].radius
            away = abs(robots[one].plant.position - robots[other].plant.position)
            least = min(least, away - radii)
    return least


@pytest.mark.parametrize(
    "fleet",
    [
        lambda: Fleet(CROSSING),
        lambda: Fleet(CROSSING, loss=0.2, seed=1),
        lambda: Fleet(CROSSING, delay=(0.05, 0.15), seed=2),
    ],
    ids=["good air", "lossy air", "late air"],
)
def test_robots_that_start_in_each_others_slots_touch_nobody_and_come_into_formation(fleet: Any) -> None:
    team = fleet()
    assert room(team, 30.0) > 0.0
    assert team.error() < SIX.settled


def test_to_slow_down_for_a_body_waits_for_no_ramp() -> None:
    assert room(Fleet(changed(CROSSING, ramp=1.0)), 10.0) > 0.0


def test_without_the_filter_they_would_touch() -> None:
    assert room(Fleet(scenarios.exchanged(SIX, mode="off")), 10.0) < 0.0


def test_who_only_warns_says_what_it_would_do_and_does_what_it_did() -> None:
    warns, off = (Fleet(scenarios.exchanged(FILE, mind=(), mode=mode)) for mode in ("warn", "off"))
    said = set()
    for _ in range(20):
        warns.run(0.25)
        off.run(0.25)
        said |= {warns.status(name).get("collisions") for name in FILE.followers}
    assert warns.commands == off.commands
    assert {"warn: clear", "warn: would get out of the way"} <= said
    assert "collisions" not in off.status("robot3")


def test_a_robot_hears_the_positions_of_those_it_minds_and_nothing_else_of_them() -> None:
    alone, minding = (set(Agent(one, "robot2").subscriptions) for one in (LONERS, CROSSING))
    others = {POSITION.key(name) for name in SIX.followers if name != "robot2"}
    assert minding - alone == others
    assert set(Agent(CROSSING, "robot2", "paper").subscriptions) == alone


def test_the_status_says_who_is_minded_who_was_never_heard_and_what_came_of_it() -> None:
    fleet = Fleet(scenarios.exchanged(FILE))
    fleet.kill("robot4")
    fleet.run(8.0)
    said = fleet.status("robot3")
    assert said["minds"] == "robot2, robot4"
    assert said["minds unseen"] == "robot4"
    assert int(said["avoided"]) > 0
    assert int(said["deadlocks"]) >= 0
    assert said["collisions"] in {"on: clear", "on: gets out of the way"}


def test_who_measures_only_the_leader_minds_nobody_unless_told_to() -> None:
    fleet = Fleet(LONERS)
    fleet.run(2.0)
    assert "collisions" not in fleet.status("robot2")


def test_a_robot_that_died_in_front_is_driven_round() -> None:
    fleet = Fleet(PATROL)
    fleet.run(9.0)
    fleet.kill("robot1")
    fleet.world._hosted["robot1"].plant.obey(AT_REST)
    assert room(fleet, 13.0) > 0.0
    leader, *points = fleet.points()
    slot = fleet.leader.figure.slots(fleet.mission)[2]
    assert abs(points[1] - leader - slot) < 0.02


@pytest.mark.parametrize("measurement", ["network", "local"])
@pytest.mark.parametrize(
    ("speed", "top", "rate", "coasts"),
    [(0.2, 0.8, 20.0, 0.0), (0.6, 0.8, 20.0, 0.0), (0.6, 0.8, 20.0, 0.15), (0.28, 0.3, 5.0, 0.0)],
)
def test_who_dies_at_any_speed_in_front_of_another_is_not_run_over(
    speed: float, top: float, rate: float, coasts: float, measurement: str
) -> None:
    mission = team(
        {"robot1": ("leader",), "robot2": ("leader",)},
        mind="all",
        max_speed=top,
        rate=rate,
        measurement=measurement,
    )
    row = {"robot1": (-0.8, 0.0), "robot2": (-1.5, 0.0)}
    fleet = Fleet(
        mission.model_copy(
            update={"shapes": {"row": row}, "route": (Straight(speed=speed, heading_deg=0.0),)}
        )
    )
    fleet.run(8.0)
    fleet.kill("robot1")
    fleet.run(coasts)
    fleet.plant("robot1").obey(AT_REST)
    assert room(fleet, 8.0) > 0.0
