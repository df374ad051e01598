"""The shipped patrol: shapes that can be changed into each other, and nobody whom the others cannot lose."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from formation.mission.file import load

PATROL = load("patrol")
SHARES = np.linspace(0.0, 1.0, 51)
MARGIN = 0.15
"""What robots may be off their slots, towards each other [m]."""


def nearest(one: str, other: str, mixes: np.ndarray) -> float:
    """Least distance between two slots over mixes of the shapes, one share per column [m]."""
    apart = np.array([PATROL.slot(one, shape) - PATROL.slot(other, shape) for shape in PATROL.shapes])
    return float(np.abs(mixes @ apart).min())


def needed(one: str, other: str) -> float:
    """Distance of two slots at which bodies do not touch, whichever way the robots look [m]."""
    first, second = PATROL.robots[one], PATROL.robots[other]
    centres = first.control_point_offset + second.control_point_offset
    return first.radius + second.radius + centres


def test_patrol_has_hexagon_line_and_wedge() -> None:
    assert list(PATROL.shapes) == ["hexagon", "line", "wedge"]
    assert len({PATROL.slot(name, "line").real for name in PATROL.followers}) == 1


@pytest.mark.parametrize(("before", "after"), list(combinations(range(3), 2)))
def test_no_change_of_shape_brings_two_bodies_together(before: int, after: int) -> None:
    mixes = np.zeros((SHARES.size, 3))
    mixes[:, before], mixes[:, after] = 1.0 - SHARES, SHARES
    for one, other in combinations(PATROL.followers, 2):
        assert nearest(one, other, mixes) > needed(one, other) + MARGIN


def test_nor_does_a_change_that_is_overtaken_by_another() -> None:
    """Then all three shapes are mixed."""
    mixes = np.array([(a, b, 1.0 - a - b) for a in SHARES for b in SHARES if a + b <= 1.0])
    for one, other in combinations(PATROL.followers, 2):
        assert nearest(one, other, mixes) > needed(one, other) + MARGIN


@pytest.mark.parametrize("lost", PATROL.followers)
def test_without_any_one_robot_all_others_still_reach_the_leader(lost: str) -> None:
    reached = {PATROL.leader}
    for _ in PATROL.followers:
        for name in PATROL.followers:
            usable = set(PATROL.robots[name].neighbours) - {lost} or set(
                PATROL.robots[name].fallback_neighbours
            ) - {lost}
            if name != lost and usable & reached:
                reached.add(name)
    assert reached == set(PATROL.names) - {lost}


def test_the_leaders_process_may_be_lost_twice() -> None:
    assert PATROL.candidates == ("leader", "deputy", "reserve")


def test_its_slots_turn_no_faster_than_robots_can_follow() -> None:
    """In the bend the outermost slot is the fastest; half of what a robot can is left to correct errors."""
    (bend,) = [leg for leg in PATROL.route if hasattr(leg, "radius")]
    rate = bend.speed / bend.radius
    for shape in PATROL.shapes:
        for name in PATROL.followers:
            speed = abs(bend.speed + 1j * rate * PATROL.slot(name, shape))
            assert speed < 0.5 * PATROL.robots[name].max_speed
