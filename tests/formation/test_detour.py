"""Who is kept from moving goes another way: to the right for a while, or round what stands."""

from __future__ import annotations

import math

import pytest

from formation.avoidance import Manners, Obstacle
from formation.detour import DETOUR, PATIENCE, Avoidance, avoid
from formation.law import Limits
from formation.unicycle import Command, advance, control_point, saturate

BODY = Limits(0.2, 1.5, 1.5)
MANNERS = Manners(0.1, 0.02, 0.15)


def test_who_is_kept_for_a_while_goes_to_the_right_for_a_while_and_that_is_counted() -> None:
    wall = [Obstacle(0.52 + 0j, 0.2, 0j, first=True)]
    memory, elapsed, turned = Avoidance(), 0.0, []
    while elapsed < PATIENCE + DETOUR + 0.2:
        done, memory = avoid(Command(1.5, 0.0), wall, MANNERS, BODY, 0j, memory, 0.05)
        turned.append(done.turn_rate)
        elapsed += 0.05
    assert memory.deadlocks == 1
    assert min(turned) == -BODY.max_turn_rate
    assert turned[0] == turned[-1] == 0.0


def test_who_is_kept_again_goes_another_way_for_longer_until_it_was_free_for_a_while() -> None:
    wall = [Obstacle(0.52 + 0j, 0.2, 0j, first=True)]
    memory, turns = Avoidance(), [0]
    for _ in range(400):
        before = memory
        _, memory = avoid(Command(1.5, 0.0), wall, MANNERS, BODY, 0j, memory, 0.05)
        turns[-1] += memory.detour > 0.0
        if memory.deadlocks > before.deadlocks:
            turns.append(0)
    assert turns[1:4] == pytest.approx([DETOUR * times / 0.05 for times in (1, 2, 3)], abs=1.0)
    free = [Obstacle(9.0 + 0j, 0.2, 0j, first=True)]
    for _ in range(600):
        _, memory = avoid(Command(1.5, 0.0), free, MANNERS, BODY, 0j, memory, 0.05)
    assert memory.again == 0.0


@pytest.mark.parametrize("stands", [True, False])
def test_who_goes_to_and_fro_before_what_stands_is_kept(stands: bool) -> None:
    post, memory, speeds = Obstacle(0j, 0.2, 0j, first=True, stands=stands), Avoidance(), set()
    for step in range(40):
        seen = post._replace(at=0.57 + 0j if step % 2 else 0.47 + 0j)  # as noise has it
        done, memory = avoid(Command(1.5, 0.0), [seen], MANNERS, BODY, 0j, memory, 0.05)
        speeds.add(round(done.speed, 3))
    assert {0.2, -0.2} <= speeds
    assert (memory.deadlocks > 0) == stands


def test_who_goes_along_with_those_it_follows_and_no_further_is_kept_too() -> None:
    wall = [Obstacle(0.52 + 0j, 0.2, 0.2 + 0j, first=True)]
    memory = Avoidance()
    for _ in range(20):
        _, memory = avoid(Command(1.5, 0.0), wall, MANNERS, BODY, 0.2 + 0j, memory, 0.05)
    assert memory.deadlocks == 1


@pytest.mark.parametrize("middle", [0.0, 0.1, -0.3])
def test_a_row_of_posts_that_leaves_no_gap_is_gone_round(middle: float) -> None:
    row = [complex(1.5, middle + aside) for aside in (-0.7, -0.35, 0.0, 0.35, 0.7)]
    at, heading, memory, nearest, goal = 0j, 1.0 + 0j, Avoidance(), math.inf, 3.0 + 0j
    for _ in range(600):
        around = [
            Obstacle(heading.conjugate() * (post - at), 0.2, 0j, first=True, stands=True) for post in row
        ]
        away = heading.conjugate() * (goal - control_point(at, heading, BODY.offset))
        wanted = saturate(2.0 * away, BODY.offset, BODY.max_speed, BODY.max_turn_rate)
        command, memory = avoid(wanted, around, MANNERS, BODY, 0j, memory, 0.05)
        at, heading = advance(at, heading, command.speed, command.turn_rate, 0.05)
        nearest = min(nearest, *(abs(at - post) for post in row))
    assert nearest > 0.3
    assert control_point(at, heading, BODY.offset) == pytest.approx(goal, abs=0.01)
