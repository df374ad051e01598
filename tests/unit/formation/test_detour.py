"""Who is kept from moving goes another way: to the right for a while, or round what stands."""

from __future__ import annotations

import math

import pytest

from formation.control.avoidance import (
    DEADLOCK_DELAY,
    DETOUR_TIME,
    Avoidance,
    AvoidanceParameters,
    Obstacle,
    avoid,
)
from formation.control.controller import Limits
from formation.control.unicycle import Command, advance, control_point, saturate

BODY = Limits(0.2, 1.5, 1.5)
PARAMETERS = AvoidanceParameters(0.1, 0.02, 0.15)


def test_blocked_robot_detours_right_and_counts_a_deadlock() -> None:
    wall = [Obstacle(0.52 + 0j, 0.2, 0j, first=True)]
    avoidance, elapsed, turned = Avoidance(), 0.0, []
    while elapsed < DEADLOCK_DELAY + DETOUR_TIME + 0.2:
        done, avoidance = avoid(Command(1.5, 0.0), wall, PARAMETERS, BODY, 0j, avoidance, 0.05)
        turned.append(done.turn_rate)
        elapsed += 0.05
    assert avoidance.deadlocks == 1
    assert min(turned) == -BODY.max_turn_rate
    assert turned[0] == turned[-1] == 0.0


def test_repeated_deadlocks_lengthen_detours_until_free() -> None:
    wall = [Obstacle(0.52 + 0j, 0.2, 0j, first=True)]
    avoidance, turns = Avoidance(), [0]
    for _ in range(400):
        before = avoidance
        _, avoidance = avoid(Command(1.5, 0.0), wall, PARAMETERS, BODY, 0j, avoidance, 0.05)
        turns[-1] += avoidance.detour > 0.0
        if avoidance.deadlocks > before.deadlocks:
            turns.append(0)
    assert turns[1:4] == pytest.approx([DETOUR_TIME * times / 0.05 for times in (1, 2, 3)], abs=1.0)
    free = [Obstacle(9.0 + 0j, 0.2, 0j, first=True)]
    for _ in range(600):
        _, avoidance = avoid(Command(1.5, 0.0), free, PARAMETERS, BODY, 0j, avoidance, 0.05)
    assert avoidance.again == 0.0


@pytest.mark.parametrize("stands", [True, False])
def test_oscillation_is_a_deadlock_only_before_standing_obstacles(stands: bool) -> None:
    post, avoidance, speeds = Obstacle(0j, 0.2, 0j, first=True, stands=stands), Avoidance(), set()
    for step in range(40):
        seen = post._replace(at=0.57 + 0j if step % 2 else 0.47 + 0j)  # as noise has it
        done, avoidance = avoid(Command(1.5, 0.0), [seen], PARAMETERS, BODY, 0j, avoidance, 0.05)
        speeds.add(round(done.speed, 3))
    assert {0.2, -0.2} <= speeds
    assert (avoidance.deadlocks > 0) == stands


def test_robot_held_at_neighbour_speed_counts_as_blocked() -> None:
    wall = [Obstacle(0.52 + 0j, 0.2, 0.2 + 0j, first=True)]
    avoidance = Avoidance()
    for _ in range(20):
        _, avoidance = avoid(Command(1.5, 0.0), wall, PARAMETERS, BODY, 0.2 + 0j, avoidance, 0.05)
    assert avoidance.deadlocks == 1


@pytest.mark.parametrize("middle", [0.0, 0.1, -0.3])
def test_a_row_of_posts_that_leaves_no_gap_is_gone_round(middle: float) -> None:
    row = [complex(1.5, middle + aside) for aside in (-0.7, -0.35, 0.0, 0.35, 0.7)]
    at, heading, avoidance, nearest, goal = 0j, 1.0 + 0j, Avoidance(), math.inf, 3.0 + 0j
    for _ in range(600):
        around = [
            Obstacle(heading.conjugate() * (post - at), 0.2, 0j, first=True, stands=True) for post in row
        ]
        away = heading.conjugate() * (goal - control_point(at, heading, BODY.offset))
        wanted = saturate(2.0 * away, BODY.offset, BODY.max_speed, BODY.max_turn_rate)
        command, avoidance = avoid(wanted, around, PARAMETERS, BODY, 0j, avoidance, 0.05)
        at, heading = advance(at, heading, command.speed, command.turn_rate, 0.05)
        nearest = min(nearest, *(abs(at - post) for post in row))
    assert nearest > 0.3
    assert control_point(at, heading, BODY.offset) == pytest.approx(goal, abs=0.01)
