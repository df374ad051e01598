"""Robots with bodies wider than what scanners see of them: of a TurtleBot3, its own scanner."""

from __future__ import annotations

import pytest

from formation.mission.file import parse
from formation.mission.model import Mission
from formation.stability.analysis import analyse
from tests.support.fleet import Fleet

TOWER = "seen = { radius = 0.035, x = -0.032 }"


def facing(*, mode: str, passes: bool, seen: str = TOWER) -> Mission:
    """Two Burgers that do not receive each other's positions; one drives towards the front of the other.

    If it `passes`, both change sides; otherwise the other stands, and its slot is beyond.
    """
    slot, start = ("[1.0, 0.0]", -1.0) if passes else ("[0.05, 0.0]", 0.0)
    return parse(
        f"""
        name = "facing"
        leader = "leader"
        [law]
        k_p = 2.0
        k_i = 0.2
        [robot]
        control_point_offset = 0.05
        max_speed = 0.2108
        max_turn_rate = 2.635
        radius = 0.105
        rate = 20
        scanner = "required"
        scan = {{ rate = 5, x = -0.032, margin = 0.05 }}
        {seen}
        [simulated_robot]
        profile = "turtlebot3_burger"
        [collisions]
        lag = 0.1
        mode = "{mode}"
        [shapes.swapped]
        robot1 = [-1.0, 0.0]
        robot2 = {slot}
        [[route]]
        speed = 0.0
        heading_deg = 0
        [robots.leader]
        start = {{ x = 0.0, y = 3.0 }}
        [robots.robot1]
        neighbours = ["leader"]
        start = {{ x = 1.0, y = 3.0, heading_deg = 180 }}
        [robots.robot2]
        neighbours = ["leader"]
        start = {{ x = {start}, y = 3.0, heading_deg = 0 }}
        """
    )


def nearest(fleet: Fleet, seconds: float = 20.0) -> float:
    """Least distance between the two bodies [m]."""
    least = float("inf")
    for _ in fleet.every(0.05, seconds):
        fleet.points()  # has all be where they are by now
        least = min(least, abs(fleet.plant("robot1").position - fleet.plant("robot2").position) - 0.21)
    return least


def test_robots_pass_bodies_wider_than_what_is_seen() -> None:
    fleet = Fleet(facing(mode="on", passes=True))
    assert nearest(fleet) > 0.05
    assert fleet.error() < 0.03


def test_zone_stops_before_a_body_wider_than_what_is_seen() -> None:
    fleet = Fleet(facing(mode="off", passes=False))
    assert 0.04 < nearest(fleet, 10.0) < 0.15
    assert fleet.status("robot1").zone == "stop"


def test_zone_is_as_before_where_bodies_are_seen() -> None:
    fleet = Fleet(facing(mode="off", passes=False, seen=""))
    assert 0.04 < nearest(fleet, 10.0) < 0.1


@pytest.mark.parametrize(("seen", "warns"), [("", True), (TOWER, False)])
def test_check_warns_of_burgers_whose_scanners_are_not_stated(seen: str, *, warns: bool) -> None:
    warnings = analyse(facing(mode="on", passes=True, seen=seen)).warnings
    assert any("seen = { radius = 0.035" in one for one in warnings) == warns
