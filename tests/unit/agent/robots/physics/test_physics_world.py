"""What robots with mass, motors and wheels do when they are told to drive, and what they believe they did."""

from __future__ import annotations

import math

import pytest

from formation.control.unicycle import Command
from formation.mission.model import Mission
from tests.support import needs

pytestmark = pytest.mark.physics
needs.leave_out_without("physics")

from formation.agent.simulated.physics.world import World  # noqa: E402 - only where there is MuJoCo
from tests.support.physics_worlds import PAIR, SIX, drive, placed, standing, touching, turned  # noqa: E402

LDS = (0j, 1.0 + 0.0j, 360, 3.5)
MISSIONS = pytest.mark.parametrize(("mission", "name"), [(PAIR, "robot1"), (SIX, "robot2")])


@MISSIONS
@pytest.mark.parametrize("speed", [0.1, 0.2, -0.1])
def test_robot_drives_straight_at_commanded_speed(mission: Mission, name: str, speed: float) -> None:
    world = World(mission)
    before = drive(world, 1.0, **{name: (speed, 0.0)})[name]
    after = drive(world, 5.0)[name]
    way = (after.position - before.position) * before.heading.conjugate()
    assert way.real == pytest.approx(5.0 * speed, rel=0.01)
    assert abs(turned(before, after)) < 0.01


@MISSIONS
@pytest.mark.parametrize("turn_rate", [0.5, -1.0])
def test_robot_turns_on_the_spot_at_commanded_rate(mission: Mission, name: str, turn_rate: float) -> None:
    world = World(mission)
    before = drive(world, 1.0, **{name: (0.0, turn_rate)})[name]
    after = drive(world, 2.0)[name]
    assert turned(before, after) == pytest.approx(2.0 * turn_rate, rel=0.01)
    assert abs(after.position - before.position) < 0.005


@MISSIONS
def test_a_robot_drives_along_the_circle_that_it_is_told(mission: Mission, name: str) -> None:
    world = World(mission)
    before = drive(world, 1.0, **{name: (0.15, 0.5)})[name]
    halfway = drive(world, math.pi / 0.5)[name]
    assert abs(halfway.position - before.position) == pytest.approx(2 * 0.15 / 0.5, rel=0.01)


@MISSIONS
def test_a_robot_at_rest_stays_where_it_is(mission: Mission, name: str) -> None:
    world = World(mission)
    before = world.states[name]
    after = drive(world, 5.0)[name]
    assert abs(after.position - before.position) < 1e-3
    assert abs(turned(before, after)) < 1e-3


@MISSIONS
def test_a_robot_that_is_told_to_stop_stops_upright_and_soon(mission: Mission, name: str) -> None:
    world, top = World(mission), mission.robots[name].max_speed
    drive(world, 2.0, **{name: (top, 0.0)})
    before = drive(world, 0.0, **{name: (0.0, 0.0)})[name]
    after = drive(world, 1.0)[name]
    assert abs(after.moving.speed) < 0.01
    assert abs(after.position - before.position) < 0.5 * top
    tilt = world.data.body(f"{name}/base").xmat[8]
    assert tilt == pytest.approx(1.0, abs=1e-3)


def test_motor_torque_and_wheel_rate_are_limited() -> None:
    world, fastest = World(PAIR), 0.0
    most = world.chassis["robot1"]
    for number in range(200):
        drive(world, 0.02, robot1=(100.0, 0.0) if number < 100 else (-100.0, 100.0))
        rates = [abs(world.data.joint(f"robot1/{side}").qvel[0]) for side in ("left", "right")]
        fastest = max(fastest, *rates)
        given = [world.data.actuator(f"robot1/{side}").force[0] for side in ("left", "right")]
        assert max(map(abs, given)) <= most.torque
    assert 0.98 * most.wheel_rate < fastest < 1.05 * most.wheel_rate


def test_burger_motors_cannot_reach_both_limits_together() -> None:
    top, most_turn = PAIR.robots["robot1"].max_speed, PAIR.robots["robot1"].max_turn_rate
    one, other, both = (
        drive(World(PAIR), 2.0, robot1=reported)["robot1"].moving
        for reported in ((top, 0.0), (0.0, most_turn), (top, most_turn))
    )
    assert one.speed == pytest.approx(0.21, rel=0.01)  # its node cuts off hundredths
    assert other.turn_rate == pytest.approx(2.63, rel=0.01)
    assert both.speed < 0.6 * top
    assert both.turn_rate < 0.6 * most_turn


def test_the_motors_of_other_robots_reach_both_limits_at_once() -> None:
    world, spec = World(placed(SIX, robot2=(20j, 0.0))), SIX.robots["robot2"]  # where nobody is in its way
    moving = drive(world, 3.0, robot2=(spec.max_speed, spec.max_turn_rate))["robot2"].moving
    assert moving.speed == pytest.approx(spec.max_speed, rel=0.02)
    assert moving.turn_rate == pytest.approx(spec.max_turn_rate, rel=0.02)


def test_wheels_slip_at_wall_while_odometry_counts_on() -> None:
    mission = placed(PAIR, robot1=(0j, 0.0), robot2=(0.0 - 2j, 0.0))
    world = World(standing(mission, walls=[(0.2 - 1j, 0.2 + 1j)]))
    drive(world, 4.0, robot1=(0.1, 0.0))
    assert frozenset({"robot1"}) in touching(world)
    before = world.states["robot1"]
    after = drive(world, 5.0)["robot1"]
    assert abs(after.position - before.position) < 0.02
    assert abs(after.counted_position - before.counted_position) == pytest.approx(0.5, rel=0.1)
    assert after.position.real + 0.038 < 0.2 + 0.01  # its front is not in the wall


@pytest.mark.parametrize("mission", [PAIR, SIX])
def test_two_robots_that_drive_at_each_other_cannot_pass_through(mission: Mission) -> None:
    first, second = mission.followers[:2]
    world = World(placed(mission, **{first: (-0.5 + 9j, 0.0), second: (0.5 + 9j, math.pi)}))
    for _ in range(60):
        states = drive(world, 0.1, **{first: (0.15, 0.0), second: (0.15, 0.0)})
        apart = states[second].position - states[first].position
        assert abs(apart) > 0.07
    assert frozenset({first, second}) in touching(world)


def test_a_post_stands_in_the_way() -> None:
    world = World(standing(placed(SIX, robot2=(9j, 0.0)), posts=[(0.6 + 9j, 0.1)]))
    for _ in range(60):
        state = drive(world, 0.1, robot2=(0.2, 0.0))["robot2"]
        assert abs(state.position - (0.6 + 9j)) > 0.19


def test_odometry_drifts_but_little() -> None:
    world = World(PAIR, seed=3)
    for turn_rate in (0.5, -0.5, 0.0) * 2:
        states = drive(world, 5.0, robot1=(0.1, turn_rate), robot2=(0.1, turn_rate))
    off = [abs(state.position - state.counted_position) for state in states.values()]
    assert all(0.0005 < one < 0.02 * 3.0 for one in off)  # after 3 m


def test_odometry_counts_ticks() -> None:
    world, tick = World(PAIR), 2.0 * math.pi * 0.033 / 4096
    start = world.states["robot1"].counted_position
    drive(world, 1.0, robot1=(0.05, 0.0))
    after = drive(world, 2.0, robot1=(0.0, 0.0))["robot1"]
    ticks = 2.0 * abs(after.counted_position - start) / tick  # of both wheels together
    assert ticks == pytest.approx(round(ticks), abs=0.01)


def test_equal_seeds_give_equal_runs_and_other_seeds_others() -> None:
    def run(seed: int) -> complex:
        world = World(PAIR, seed)
        drive(world, 1.234, robot1=(0.2, 0.7), robot2=(0.1, -1.0))
        return drive(world, 3.0, robot1=(0.1, -0.3))["robot1"].position

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_time_goes_by_as_asked_however_it_is_cut() -> None:
    ends = []
    for dt in (0.0007, 0.05, 0.5):
        world = World(PAIR)
        for number in range(round(3.5 / dt)):
            state = world.step({"robot1": Command(0.1, 0.2)} if number == 0 else {}, dt)["robot1"]
        assert world.data.time == pytest.approx(3.5, abs=0.003)
        ends.append(state.position)
    assert ends[1] == pytest.approx(ends[0], abs=1e-4)
    assert ends[2] == pytest.approx(ends[0], abs=1e-4)


@MISSIONS
def test_robot_has_weight_of_its_size_on_wheels(mission: Mission, name: str) -> None:
    world = World(mission)
    one = world.chassis[name]
    assert world.model.body(f"{name}/base").subtreemass[0] == pytest.approx(one.weight)
    if mission is PAIR:
        assert one.weight == pytest.approx(1.0, abs=0.01)
    drive(world, 1.0)
    assert abs(world.data.body(f"{name}/base").xpos[2]) < 0.002


def test_scanner_measures_distance_to_post_wall_and_robot() -> None:
    mission = placed(SIX, robot2=(9j, math.pi / 2), robot3=(-1.0 + 9j, 0.0))
    world = World(standing(mission, posts=[(1.0 + 9j, 0.1)], walls=[(-2 + 11j, 2 + 11j)]))
    ranges = world.scan("robot2", *LDS)
    assert ranges.shape == (360,)
    assert ranges[0] == pytest.approx(1.99, abs=0.001)  # ahead: the wall
    assert ranges[270] == pytest.approx(0.9, abs=0.001)  # to the right: the post
    assert ranges[90] == pytest.approx(1.0 - mission.robots["robot3"].radius, abs=0.001)  # to the left
    assert math.isinf(ranges[180])  # behind: nothing within its range
