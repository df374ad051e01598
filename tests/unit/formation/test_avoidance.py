"""The collision filter: what holds for every wanted command, and detours round obstacles."""

from __future__ import annotations

import cmath
import math
from itertools import combinations
from random import Random

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from formation.control.avoidance import (
    DEADLOCK_DELAY,
    DETOUR_TIME,
    MAX_HEADING_ERROR,
    Avoidance,
    AvoidanceParameters,
    HalfPlane,
    Moving,
    Obstacle,
    avoid,
    brake,
    facing,
    give_way,
    half_plane,
    heading_doubt,
    nearest,
)
from formation.control.controller import Limits
from formation.control.observer import Travel, innovation
from formation.control.plane import angle_between, rotation
from formation.control.unicycle import AT_REST, Command, advance, control_point, driven, saturate
from tests.support.examples import examples
from tests.unit.formation.planar import angles, headings, vectors

BODY = Limits(0.2, 1.5, 1.5)
PARAMETERS = AvoidanceParameters(0.1, 0.02, 0.15)
seeds = st.integers(0, 2**32)
doubts = st.floats(0.0, 4.0)
commands = st.builds(Command, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
near = vectors.map(lambda at: 0.2 * at)
obstacles = st.lists(
    st.builds(Obstacle, near, st.floats(0.05, 0.3), vectors, st.booleans(), st.booleans(), doubts), max_size=5
)


class Crowd:
    """Robots with random wanted commands and with heading errors up to `doubt`."""

    def __init__(self, seed: int, doubt: float) -> None:
        self.draw, self.doubt = Random(seed), doubt
        at: list[complex] = []
        while len(at) < 5:
            point = complex(self.draw.uniform(-0.5, 0.5), self.draw.uniform(-0.5, 0.5))
            if all(abs(point - other) > 0.22 for other in at):
                at.append(point)
        self.poses = [(point, rotation(self.draw.uniform(-math.pi, math.pi))) for point in at]
        self.states = [Avoidance() for _ in at]

    def commands(self, dt: float) -> list[Command]:
        result = []
        for i, (here, heading) in enumerate(self.poses):
            turn = (heading * rotation(self.draw.uniform(-self.doubt, self.doubt))).conjugate()
            around = [
                Obstacle(turn * (at - here), 0.1, complex(self.draw.uniform(-1, 1)), j < i, doubt=self.doubt)
                for j, (at, _) in enumerate(self.poses)
                if j != i
            ]
            wanted = Command(self.draw.choice((-1.5, 1.5)), self.draw.uniform(-1.5, 1.5))
            done, self.states[i] = avoid(wanted, around, PARAMETERS, BODY, 0j, self.states[i], dt)
            result.append(done)
        return result

    def after(self, commands: list[Command], seconds: float) -> list[tuple[complex, complex]]:
        """Poses after the commands have applied for `seconds`."""
        return [advance(*pose, *done, seconds) for pose, done in zip(self.poses, commands, strict=True)]


@examples(40)
@given(seeds, doubts)
def test_bodies_never_touch_under_random_wanted_commands(seed: int, doubt: float) -> None:
    crowd = Crowd(seed, doubt)
    for _ in range(30):
        dt = crowd.draw.uniform(0.01, PARAMETERS.hold)
        commands = crowd.commands(dt)
        for part in (0.25, 0.5, 0.75, 1.0):
            poses = crowd.after(commands, part * dt)
            gap = min(abs(one - other) - 0.2 for (one, _), (other, _) in combinations(poses, 2))
            assert gap > (PARAMETERS.margin if doubt < math.pi else 0.0) - 1e-9
        crowd.poses = poses


@given(st.floats(0.01, 0.3), st.floats(0.0, 1.0), st.floats(0.01, 0.15), st.floats(0.3, 3.0))
def test_robots_that_lag_never_touch_head_on(lag: float, share: float, dt: float, apart: float) -> None:
    """Their true lag is some share of the stated one, and their speed between its mean and the command."""
    parameters, true_lag, step = PARAMETERS._replace(lag=lag), share * lag, dt / 8
    wheels = command = AT_REST
    mean = 0.0
    for _ in range(80):
        moving = Moving(min(mean, command.speed), max(mean, command.speed))
        command = brake(Command(1.5, 0.0), [Obstacle(apart + 0j, 0.1, 0j, first=True)], parameters, moving)
        before = apart
        for _ in range(8):
            gone, wheels = driven(wheels, command, true_lag, step)
            apart -= 2.0 * gone.speed * step
            assert apart > 0.22 - 1e-9
        mean = 0.5 * (before - apart) / dt


@given(seeds, st.floats(0.02, 0.3))
def test_robots_that_lag_never_touch_with_any_wanted_speeds(seed: int, lag: float) -> None:
    """Commands at the same moments, each replaced within two thirds of the time that it may last."""
    draw, parameters = Random(seed), PARAMETERS._replace(lag=lag)
    apart, wheels, before = 0.22 + draw.uniform(0.0, 0.3), [AT_REST, AT_REST], [AT_REST, AT_REST]
    for _ in range(60):
        obstacle = Obstacle(apart + 0j, 0.1, 0j, first=True)
        for i in (0, 1):
            ends = sorted((wheels[i].speed, before[i].speed))
            wanted = Command(draw.choice((-1.5, 0.0, 0.3, 1.5, 1.5)), 0.0)
            before[i] = brake(wanted, [obstacle], parameters, Moving(*ends))
        step = draw.uniform(0.01, PARAMETERS.hold * 2.0 / 3.0) / 8
        for _ in range(8):
            for i in (0, 1):
                gone, wheels[i] = driven(wheels[i], before[i], lag, step)
                apart -= gone.speed * step
            assert apart > 0.22 - 1e-9


@examples(100)
@given(seeds, st.sampled_from((0.0, 0.1)))
def test_robots_with_own_rhythm_never_touch(seed: int, lag: float) -> None:
    """Each replaces its commands in its own period, a third of the time that they may last."""
    draw, parameters, period = Random(seed), PARAMETERS._replace(lag=lag), PARAMETERS.hold / 3.0
    at = [0j, 0.22 + draw.uniform(0.0, 0.1) + 0j]
    heading = [rotation(draw.uniform(-math.pi, math.pi)) for _ in at]
    wheels, commands, next_at = [AT_REST, AT_REST], [AT_REST, AT_REST], [0.0, draw.uniform(0.0, period)]
    wanted = [AT_REST, AT_REST]
    for step in range(400):
        for i in (0, 1):
            if step * period / 8 < next_at[i]:
                continue
            next_at[i] += period
            if draw.random() < 0.3:
                wanted[i] = Command(draw.choice((-1.5, 1.5)), draw.uniform(-1.5, 1.5))
            there = heading[i].conjugate() * (at[1 - i] - at[i])
            ends = sorted((wheels[i].speed, commands[i].speed))
            obstacle = Obstacle(there, 0.1, 0j, first=True)
            commands[i] = brake(wanted[i], [obstacle], parameters, Moving(*ends))
        for i in (0, 1):
            gone, wheels[i] = driven(wheels[i], commands[i], lag, period / 8)
            at[i], heading[i] = advance(at[i], heading[i], gone.speed, gone.turn_rate, period / 8)
        assert abs(at[1] - at[0]) > 0.22 - 1e-9


@given(commands, obstacles, st.floats(0.0, 1.0))
def test_commands_stay_within_limits(wanted: Command, around: list[Obstacle], detour: float) -> None:
    done, _ = avoid(wanted, around, PARAMETERS, BODY, 0j, Avoidance(0.0, detour), 0.05)
    assert abs(done.speed) <= BODY.max_speed
    assert abs(done.turn_rate) <= BODY.max_turn_rate


@given(st.floats(-1.5, 1.5), obstacles)
def test_turning_on_the_spot_is_always_allowed(turn_rate: float, around: list[Obstacle]) -> None:
    turning = Command(0.0, turn_rate)
    assert brake(turning, around, PARAMETERS) is turning


@given(commands, st.lists(st.builds(cmath.rect, st.floats(5.0, 9.0), angles), max_size=5), doubts)
def test_unobstructed_command_is_returned_unchanged(wanted: Command, at: list[complex], doubt: float) -> None:
    around = [Obstacle(one, 0.1, 0j, first=True, doubt=doubt) for one in at]
    done, after = avoid(wanted, around, PARAMETERS, BODY, 0j, Avoidance(), 0.05)
    assert done is wanted
    assert after._replace(went=0j, slow=0.0) == Avoidance()


@given(commands, obstacles)
def test_mirrored_obstacles_give_mirrored_command(wanted: Command, around: list[Obstacle]) -> None:
    done = brake(give_way(wanted, around, PARAMETERS, BODY), around, PARAMETERS)
    flipped = Command(wanted.speed, -wanted.turn_rate)
    others = [one._replace(at=one.at.conjugate(), velocity=one.velocity.conjugate()) for one in around]
    assert brake(give_way(flipped, others, PARAMETERS, BODY), others, PARAMETERS) == pytest.approx(
        (done.speed, -done.turn_rate), abs=1e-6
    )


@given(vectors, st.lists(st.tuples(headings, st.floats(0.0, 3.0)), min_size=1, max_size=6), seeds)
def test_nearest_returns_closest_allowed_point(
    wanted: complex, drawn: list[tuple[complex, float]], seed: int
) -> None:
    bounds = [HalfPlane(normal.real, normal.imag, most) for normal, most in drawn]

    def beyond(point: complex) -> float:
        return max(one.x * point.real + one.y * point.imag - one.most for one in bounds)

    assume(beyond(wanted) > 1e-6)
    found, point = nearest(wanted, bounds)
    assert found
    assert beyond(point) < 1e-6
    draw = Random(seed)
    for _ in range(50):
        other = point + complex(draw.gauss(0.0, 0.3), draw.gauss(0.0, 0.3))
        if beyond(other) <= 0.0:
            assert abs(other - wanted) >= abs(point - wanted) - 1e-6


def test_nearest_reports_whether_bounds_intersect() -> None:
    assert nearest(0.5 + 0.5j, [HalfPlane(1.0, 0.0, 1.0), HalfPlane(0.0, 1.0, 1.0)]) == (True, 0.5 + 0.5j)
    assert nearest(0j, [HalfPlane(1.0, 0.0, -1.0), HalfPlane(-1.0, 0.0, -1.0)]) == (False, 0j)


def test_surrounded_robot_approaches_no_obstacle() -> None:
    around = [Obstacle(rotation(angle) * 0.35, 0.1, 0j, first=True) for angle in (0.0, 2.1, 4.2)]
    done = give_way(Command(1.5, 1.0), around, PARAMETERS, BODY)
    for one in around:
        bound = half_plane(one, PARAMETERS, BODY)
        assert bound.x * done.speed + bound.y * BODY.offset * done.turn_rate <= max(bound.most, 0.0) + 1e-9


@given(headings, st.floats(-3.0, 3.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(-1.0, 1.0))
def test_facing_bounds_contain_the_cosine(
    towards: complex, turn: float, doubt: float, part: float, wrong: float
) -> None:
    least, greatest = facing(towards, turn, doubt)
    cosine = (towards * rotation(wrong * doubt - part * turn)).real
    assert least - 1e-9 <= cosine <= greatest + 1e-9


def test_robot_without_right_of_way_makes_room() -> None:
    coming = Obstacle(0.45 + 0.05j, 0.1, -0.8 + 0j, first=True)
    assert give_way(Command(0.5, 0.0), [coming], PARAMETERS, BODY).speed < 0.0
    assert give_way(Command(0.5, 0.0), [coming._replace(first=False)], PARAMETERS, BODY).speed > 0.0


@given(headings, headings, seeds)
def test_heading_error_of_observer_stays_within_heading_doubt(
    truth: complex, guess: complex, seed: int
) -> None:
    draw, way, estimate, gain = Random(seed), 0.0, guess, 5.0
    here, heading = 0j, truth
    for _ in range(60):
        speed, turn_rate = draw.uniform(-0.5, 0.5), draw.uniform(-1.5, 1.5)
        there, heading = advance(here, heading, speed, turn_rate, 0.05)
        estimate = innovation(estimate, Travel(0.05 * speed, 0.05 * turn_rate, there - here), gain)
        here, way = there, way + abs(0.05 * speed)
        doubt = heading_doubt(way, gain, 0.0)
        if doubt < math.pi:
            # the path is an arc, but the observer uses its chord: shorter by less than (ωΔt)²/24
            assert abs(angle_between(estimate, heading)) <= doubt - MAX_HEADING_ERROR + 1e-3


WALL = Obstacle(0.52 + 0j, 0.2, 0j, first=True)


def straight_on(avoidance: Avoidance, one: Obstacle = WALL, along: complex = 0j) -> tuple[Command, Avoidance]:
    """One step of the filter for a robot that wants to drive straight ahead."""
    return avoid(Command(1.5, 0.0), [one], PARAMETERS, BODY, along, avoidance, 0.05)


def test_blocked_robot_detours_right_and_counts_a_deadlock() -> None:
    avoidance, turned = Avoidance(), []
    for _ in range(round((DEADLOCK_DELAY + DETOUR_TIME + 0.2) / 0.05)):
        done, avoidance = straight_on(avoidance)
        turned.append(done.turn_rate)
    assert avoidance.deadlocks == 1
    assert min(turned) == -BODY.max_turn_rate
    assert turned[0] == turned[-1] == 0.0


def test_repeated_deadlocks_cause_detours_of_same_length() -> None:
    avoidance, turns = Avoidance(), [0]
    for _ in range(400):
        deadlocks = avoidance.deadlocks
        _, avoidance = straight_on(avoidance)
        turns[-1] += avoidance.detour > 0.0
        if avoidance.deadlocks > deadlocks:
            turns.append(0)
    assert turns[1:4] == pytest.approx([DETOUR_TIME / 0.05] * 3, abs=1.0)


@pytest.mark.parametrize("stands", [True, False])
def test_oscillation_is_a_deadlock_only_before_standing_obstacles(stands: bool) -> None:
    avoidance, speeds = Avoidance(), set()
    for step in range(40):
        seen = WALL._replace(at=0.57 + 0j if step % 2 else 0.47 + 0j, stands=stands)  # as noise moves it
        done, avoidance = straight_on(avoidance, seen)
        speeds.add(round(done.speed, 3))
    assert {0.4, -0.3} <= speeds
    assert (avoidance.deadlocks > 0) == stands


def test_robot_held_at_neighbour_speed_counts_as_blocked() -> None:
    avoidance = Avoidance()
    for _ in range(20):
        _, avoidance = straight_on(avoidance, WALL._replace(velocity=0.2 + 0j), 0.2 + 0j)
    assert avoidance.deadlocks == 1


def reaches_goal(posts: list[complex], body: Limits, steps: int, *, stands: bool) -> bool:
    """Whether a robot reaches its goal behind the posts without touching them."""
    at, heading, avoidance, nearest, goal = 0j, 1.0 + 0j, Avoidance(), math.inf, 3.0 + 0j
    for _ in range(steps):
        around = [WALL._replace(at=heading.conjugate() * (post - at), stands=stands) for post in posts]
        away = heading.conjugate() * (goal - control_point(at, heading, body.offset))
        wanted = saturate(2.0 * away, body.offset, body.max_speed, body.max_turn_rate)
        command, avoidance = avoid(wanted, around, PARAMETERS, body, 0j, avoidance, 0.05)
        at, heading = advance(at, heading, command.speed, command.turn_rate, 0.05)
        nearest = min(nearest, *(abs(at - post) for post in posts))
    return nearest > 0.3 and abs(control_point(at, heading, body.offset) - goal) < 0.01


@pytest.mark.parametrize("aside", [0.0, 0.02, -0.1])
def test_robot_drives_round_single_post(aside: float) -> None:
    assert reaches_goal([complex(1.5, aside)], Limits(0.1, 1.0, 1.5), 400, stands=False)


@pytest.mark.parametrize("middle", [0.0, 0.1, -0.3])
def test_robot_drives_round_row_of_posts_without_gap(middle: float) -> None:
    row = [complex(1.5, middle + aside) for aside in (-0.7, -0.35, 0.0, 0.35, 0.7)]
    assert reaches_goal(row, BODY, 600, stands=True)
