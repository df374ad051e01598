"""Protective zones: a robot with guarded commands can stop before every scan point."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.unicycle import AT_REST, Command, advance, driven
from formation.control.zones import STANDSTILL_DISTANCE, Body, Zone, free, guarded
from tests.support.examples import slow

RADIUS, MARGIN, LAG, PERIOD = 0.105, 0.03, 0.1, 0.05
BODY = Body(RADIUS, MARGIN, LAG)
REACH = RADIUS + MARGIN
STILL = Command(0.0, 0.0)
metres = st.floats(-2.0, 2.0)
places = st.builds(complex, metres, metres)
clear = places.filter(lambda point: abs(point) > REACH)
speeds, turn_rates = st.floats(-1.5, 1.5), st.floats(-3.0, 3.0)
commands = st.builds(Command, speeds, turn_rates)


class Robot:
    """A simulated disc with lagging wheels."""

    def __init__(self, lag: float = LAG, moving: Command = STILL) -> None:
        self.position, self.heading, self.moving = 0j, 1.0 + 0j, moving
        self.lag = lag

    def go(self, command: Command, elapsed: float) -> list[complex]:
        """Follow a command; return the position after each tenth of the time."""
        places = []
        for _ in range(10):
            mean, self.moving = driven(self.moving, command, self.lag, elapsed / 10)
            self.position, self.heading = advance(self.position, self.heading, *mean, elapsed / 10)
            places.append(self.position)
        return places

    def sees(self, world: Sequence[complex]) -> list[complex]:
        return [(point - self.position) / self.heading for point in world]


@given(
    st.lists(clear, min_size=1, max_size=8),
    st.lists(st.tuples(commands, st.floats(0.01, 1.0)), min_size=1, max_size=60),
    st.sampled_from((0.0, 0.05, LAG, 0.5)),
    st.sampled_from((PERIOD, 0.2, 0.5)),
)
def test_guarded_robot_never_touches_an_obstacle(
    world: list[complex], reported: list[tuple[Command, float]], lag: float, hold: float
) -> None:
    robot = Robot(lag)
    for wanted, share in [*reported, (STILL, 1.0), (STILL, 1.0)]:
        body = Body(RADIUS, MARGIN, lag)
        command, _ = guarded(wanted, robot.moving, robot.sees(world), body, hold)
        for place in robot.go(command, share * hold):
            assert min(abs(point - place) for point in world) > REACH - 2 * STANDSTILL_DISTANCE


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 8))])
def test_allowed_command_can_stop_before_obstacle_in_path(seed: int) -> None:
    rng, tried, body = random.Random(seed), 0, Body(RADIUS, MARGIN, 0.3, spread=0.0)
    for _ in range(600):
        hold = rng.choice((0.05, 0.2, 0.6))
        moving = Command(rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0))
        wanted = Command(rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0))
        touched = rng.choice(way(moving, wanted, hold)) + cmath.rect(REACH, rng.uniform(-math.pi, math.pi))
        command, _ = guarded(wanted, moving, [touched], body, hold)
        if abs(touched) > REACH and command != AT_REST:
            tried += 1
            nearest = min(abs(touched - place) for place in way(moving, command, hold))
            assert nearest > REACH - 2 * STANDSTILL_DISTANCE
    assert tried > 100


def way(moving: Command, reported: Command, hold: float) -> list[complex]:
    """Positions of a robot that follows a command for `hold` [s] and then stops."""
    robot = Robot(0.3, moving)
    steps = [(reported, hold / 10)] * 10 + [(STILL, 0.2)] * 10
    return [place for command, time in steps for place in robot.go(command, time)]


@given(st.lists(places, max_size=8), commands, commands, st.floats(0.05, 0.5))
def test_guarded_never_speeds_up_or_reverses_a_command(
    world: list[complex], wanted: Command, moving: Command, hold: float
) -> None:
    command, zone = guarded(wanted, moving, world, BODY, hold)
    assert abs(command.speed) <= abs(wanted.speed)
    assert command.speed * wanted.speed >= 0.0
    assert command == AT_REST or command.turn_rate == wanted.turn_rate
    assert (zone is Zone.CLEAR) == (command == wanted) or command == AT_REST


@given(st.lists(places, max_size=8), commands, commands)
def test_guarded_is_symmetric_left_right_and_front_rear(
    world: list[complex], wanted: Command, moving: Command
) -> None:
    command, zone = guarded(wanted, moving, world, BODY, 0.2)
    wanted_, moving_ = (Command(one.speed, -one.turn_rate) for one in (wanted, moving))
    mirrored = guarded(wanted_, moving_, [point.conjugate() for point in world], BODY, 0.2)
    assert mirrored == (Command(command.speed, -command.turn_rate), zone)
    if wanted.speed or moving.speed:
        wanted_, moving_ = (Command(-one.speed, one.turn_rate) for one in (wanted, moving))
        back = guarded(wanted_, moving_, [-point for point in world], BODY, 0.2)
        assert back[1] is zone
        assert back[0].speed == pytest.approx(-command.speed, abs=1e-12)


@pytest.mark.parametrize("aside", [0.16, -0.16, 0.3])
def test_robot_passes_along_wall_and_past_post(aside: float) -> None:
    robot = drive(wall(complex(-1, aside), complex(6, aside)), Command(0.22, 0.0))
    assert robot.position.real > 3.0
    assert abs(robot.position.imag) < 1e-9
    assert drive([1 + 1.25j * aside], Command(0.22, 0.0)).position.real > 3.0


@given(st.lists(places, min_size=1, max_size=8), st.floats(-1.5, 0.0), st.floats(0.0, 1.5))
def test_wider_sector_has_no_more_free_distance(world: list[complex], right: float, left: float) -> None:
    wide, narrow = free(world, REACH, right, left), free(world, REACH, 0.5 * right, 0.5 * left)
    assert wide <= narrow


@given(clear, st.floats(-1.5, 0.0), st.floats(0.0, 1.5), st.floats(0.0, 1.0))
def test_no_point_is_touched_within_free_distance(
    point: complex, right: float, left: float, share: float
) -> None:
    room = free([point], REACH, right, left)
    direction = cmath.rect(1.0, right + share * (left - right))
    for number in range(20):
        way = min(room, 3.0) * number / 20
        assert abs(point - way * direction) > REACH - 1e-9


def test_free_considers_points_behind_a_wide_sector() -> None:
    assert free([cmath.rect(0.3, -3.1)], REACH, -0.05, 3.0) == pytest.approx(0.3 - REACH)


# Driving among obstacles


def drive(world: Sequence[complex], wanted: Command, seconds: float = 20.0, hold: float = 0.25) -> Robot:
    robot = Robot()
    for _ in range(round(seconds / PERIOD)):
        command, _ = guarded(wanted, robot.moving, robot.sees(world), BODY, hold)
        robot.go(command, PERIOD)
    return robot


def test_robot_near_obstacle_stops_before_reversing() -> None:
    moving, wanted = Command(-0.22, 0.0), Command(0.22, 0.5)
    assert guarded(wanted, moving, [0.18j], BODY, 0.25) == (Command(0.0, 0.5), Zone.STOP)
    assert guarded(wanted, Command(-0.005, 0.0), [0.18j], BODY, 0.25) == (wanted, Zone.CLEAR)
    assert guarded(wanted, moving, [0.3j], BODY, 0.25) == (wanted, Zone.CLEAR)


def wall(begin: complex, end: complex) -> list[complex]:
    return [begin + (end - begin) * number / 200 for number in range(201)]


@pytest.mark.parametrize("speed", [0.1, 0.22, 1.0, -0.22])
def test_robot_stops_before_post_at_the_margin(speed: float) -> None:
    ahead = math.copysign(1.0, speed)
    robot = drive([ahead + 0j], Command(speed, 0.0))
    assert ahead * robot.position.real == pytest.approx(1.0 - REACH, abs=2e-3)
    assert abs(robot.moving.speed) < 1e-3


def test_faster_robot_slows_at_greater_distance() -> None:
    def first_slow(speed: float) -> float:
        moving = Command(speed, 0.0)
        reach = [0.005 * n for n in range(1, 400)]
        return max(d for d in reach if guarded(moving, moving, [d + 0j], BODY, 0.25)[1] is not Zone.CLEAR)

    assert first_slow(0.1) < first_slow(0.2) < first_slow(0.5) < first_slow(1.0)
    assert first_slow(0.2) == pytest.approx(REACH + 0.2 * (LAG + 0.25), abs=0.01)


def test_robot_passes_wide_doorway_but_not_narrow_one() -> None:
    def doorway(width: float) -> list[complex]:
        return wall(1 - 2j, 1 - 0.5j * width) + wall(1 + 0.5j * width, 1 + 2j)

    assert drive(doorway(0.4), Command(0.22, 0.0)).position.real > 3.0
    stuck = drive(doorway(0.25), Command(0.22, 0.0))
    assert 0.8 < stuck.position.real < 1.0


def test_robot_near_obstacle_may_turn_away() -> None:
    near, inside = (wall(x - 2j, x + 2j) for x in (0.14, 0.12))  # the latter nearer than the margin
    ahead, turn, back = Command(0.2, 0.0), Command(0.0, 1.0), Command(-0.2, 0.0)
    assert guarded(ahead, STILL, near, BODY, 0.25)[0].speed < 0.05
    assert guarded(ahead, STILL, inside, BODY, 0.25) == (STILL, Zone.STOP)
    for wanted, world in ((turn, near), (back, near), (back, inside)):
        assert guarded(wanted, STILL, world, BODY, 0.25) == (wanted, Zone.CLEAR)


def test_zone_extends_to_the_side_of_the_turn() -> None:
    post = 0.25 * cmath.rect(1.0, 0.7)
    moving = Command(0.5, 0.0)
    assert guarded(moving, moving, [post], BODY, 0.25)[1] is Zone.CLEAR
    assert guarded(Command(0.5, 2.0), moving, [post], BODY, 0.25)[1] is Zone.SLOW
    assert guarded(Command(0.5, -2.0), moving, [post], BODY, 0.25)[1] is Zone.CLEAR


def test_obstacle_too_near_for_stopping_still_stops_robot() -> None:
    moving = Command(1.0, 0.5)
    assert guarded(moving, moving, [0.2 + 0j], BODY, 0.25) == (AT_REST, Zone.STOP)


@pytest.mark.parametrize("seed", range(10))
def test_range_noise_moves_stopping_position_within_margin(seed: int) -> None:
    rng, robot = random.Random(seed), Robot()
    for _ in range(400):
        seen = [point + rng.gauss(0.0, 0.005) for point in robot.sees([1 + 0j])]
        robot.go(guarded(Command(0.22, 0.0), robot.moving, seen, BODY, 0.25)[0], PERIOD)
    assert 1.0 - REACH - 0.03 < robot.position.real < 1.0 - RADIUS
