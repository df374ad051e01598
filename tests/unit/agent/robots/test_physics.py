"""Simulated robots with mass, motors and wheels, alone and in formation."""

from __future__ import annotations

import cmath
import math
from statistics import fmean

import pytest

from formation.control.unicycle import Command, advance
from formation.deploy.testing.rehearsed import RehearsedFleet
from formation.mission.file import parse, read
from formation.mission.model import Mission
from formation.ros2.messages import LaserScan, Odometry, Pose, TwistStamped, decode, encode
from formation.wire import Sample
from tests.support import needs
from tests.support.fleet import EPOCH, at

pytestmark = pytest.mark.physics
needs.leave_out_without("physics")

from formation.agent.simulated.physics.world import World  # noqa: E402 - only where there is MuJoCo
from formation.agent.simulated.simulated import World as Hosted  # noqa: E402
from tests.support.physics_worlds import (  # noqa: E402
    PAIR,
    SIX,
    InPhysics,
    at_random,
    beside_its_slots,
    drive,
    placed,
    standing,
    touching,
    turned,
)

LDS = (0j, 1.0 + 0.0j, 360, 3.5)
MISSIONS = pytest.mark.parametrize(("mission", "name"), [(PAIR, "robot1"), (SIX, "robot2")])


@MISSIONS
@pytest.mark.parametrize(
    ("speed", "turn_rate", "seconds"),
    [
        *((speed, 0.0, 5.0) for speed in (0.1, 0.2, -0.1)),
        *((0.0, turn_rate, 2.0) for turn_rate in (0.5, -1.0)),
        (0.15, 0.5, math.pi / 0.5),
    ],
)
def test_robot_drives_as_commanded(
    mission: Mission, name: str, speed: float, turn_rate: float, seconds: float
) -> None:
    world = World(mission)
    before = drive(world, 1.0, **{name: (speed, turn_rate)})[name]
    after = drive(world, seconds)[name]
    position, heading = advance(before.position, before.heading, speed, turn_rate, seconds)
    assert abs(cmath.phase(after.heading / heading)) < 0.01
    assert abs(after.position - position) < max(0.005, 0.01 * abs(position - before.position))


@MISSIONS
def test_robot_at_rest_does_not_move(mission: Mission, name: str) -> None:
    world = World(mission)
    before = world.states[name]
    after = drive(world, 5.0)[name]
    assert abs(after.position - before.position) < 1e-3
    assert abs(turned(before, after)) < 1e-3


@MISSIONS
def test_robot_stops_within_a_second_and_stays_upright(mission: Mission, name: str) -> None:
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
    assert one.speed == pytest.approx(0.21, rel=0.01)  # its node truncates to hundredths
    assert other.turn_rate == pytest.approx(2.63, rel=0.01)
    assert both.speed < 0.6 * top
    assert both.turn_rate < 0.6 * most_turn


def test_other_motors_reach_both_limits_together() -> None:
    world, spec = World(placed(SIX, robot2=(20j, 0.0))), SIX.robots["robot2"]  # far from other robots
    moving = drive(world, 3.0, robot2=(spec.max_speed, spec.max_turn_rate))["robot2"].moving
    assert moving.speed == pytest.approx(spec.max_speed, rel=0.02)
    assert moving.turn_rate == pytest.approx(spec.max_turn_rate, rel=0.02)


def test_wheels_slip_at_wall_while_odometry_keeps_counting() -> None:
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
def test_robots_cannot_drive_through_each_other(mission: Mission) -> None:
    first, second = mission.followers[:2]
    world = World(placed(mission, **{first: (-0.5 + 9j, 0.0), second: (0.5 + 9j, math.pi)}))
    for _ in range(60):
        states = drive(world, 0.1, **{first: (0.15, 0.0), second: (0.15, 0.0)})
        apart = states[second].position - states[first].position
        assert abs(apart) > 0.07
    assert frozenset({first, second}) in touching(world)


def test_robot_cannot_drive_through_post() -> None:
    world = World(standing(placed(SIX, robot2=(9j, 0.0)), posts=[(0.6 + 9j, 0.1)]))
    for _ in range(60):
        state = drive(world, 0.1, robot2=(0.2, 0.0))["robot2"]
        assert abs(state.position - (0.6 + 9j)) > 0.19


def test_odometry_drift_is_small_but_not_zero() -> None:
    world = World(PAIR, seed=3)
    for turn_rate in (0.5, -0.5, 0.0) * 2:
        states = drive(world, 5.0, robot1=(0.1, turn_rate), robot2=(0.1, turn_rate))
    off = [abs(state.position - state.counted_position) for state in states.values()]
    assert all(0.0005 < one < 0.02 * 3.0 for one in off)  # after 3 m


def test_odometry_counts_whole_encoder_ticks() -> None:
    world, tick = World(PAIR), 2.0 * math.pi * 0.033 / 4096
    start = world.states["robot1"].counted_position
    drive(world, 1.0, robot1=(0.05, 0.0))
    after = drive(world, 2.0, robot1=(0.0, 0.0))["robot1"]
    ticks = 2.0 * abs(after.counted_position - start) / tick  # of both wheels together
    assert ticks == pytest.approx(round(ticks), abs=0.01)


def test_runs_are_equal_only_for_equal_seeds() -> None:
    def run(seed: int) -> complex:
        world = World(PAIR, seed)
        drive(world, 1.234, robot1=(0.2, 0.7), robot2=(0.1, -1.0))
        return drive(world, 3.0, robot1=(0.1, -0.3))["robot1"].position

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_motion_does_not_depend_on_step_size() -> None:
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
def test_robot_has_its_weight_and_stands_on_wheels(mission: Mission, name: str) -> None:
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
    assert math.isinf(ranges[180])  # behind: no object within its range


@pytest.mark.slow
@pytest.mark.parametrize(("mission", "spread"), [(PAIR, 0.4), (SIX, 2.0)])
@pytest.mark.parametrize("seed", [1, 3])
def test_true_formation_error_stays_below_three_centimetres(
    mission: Mission, spread: float, seed: int
) -> None:
    team = InPhysics(beside_its_slots(mission, seed, spread), seed)
    team.errors(20.0)
    errors = team.errors(10.0)
    assert math.sqrt(fmean(error**2 for error in errors)) < 0.03
    assert not team.world.touched


def test_convoy_runs_in_physics_world() -> None:
    fleet = RehearsedFleet("convoy", world="mujoco")
    fleet.run(6.0)
    assert {fleet.state(name) for name in fleet.mission.followers} == {"run"}


@pytest.mark.slow
@pytest.mark.parametrize(("mission", "start"), [(SIX, 7), (PAIR, 8)])
def test_collision_filter_prevents_contact_of_robots_with_mass(mission: Mission, start: int) -> None:
    avoiding = {name: one.model_copy(update={"avoid": "all"}) for name, one in mission.robots.items()}
    mission = mission.changed(robots=avoiding)
    off = mission.model_copy(update={"collisions": mission.collisions.model_copy(update={"mode": "off"})})
    without_filter, with_filter = (InPhysics(at_random(one, 20, 1)[start], start) for one in (off, mission))
    without_filter.fleet.run(5.0)
    assert without_filter.world.touched
    with_filter.fleet.run(15.0)
    errors = with_filter.errors(10.0)
    assert not with_filter.world.touched
    assert with_filter.world.nearest > 0.0
    assert math.sqrt(fmean(error**2 for error in errors)) < 0.03


def test_physics_and_kinematic_worlds_publish_same_keys() -> None:
    team = InPhysics(PAIR)
    kinematic, physics = Hosted(PAIR), team.fleet.world
    assert physics.publications == kinematic.publications
    assert physics.subscriptions == kinematic.subscriptions
    result = [world.step(at(0.0), []) for world in (kinematic, physics)]
    assert [out.key for out in result[0]] == [out.key for out in result[1]]
    assert [len(out.payload) for out in result[0]] == [len(out.payload) for out in result[1]]
    odometry = [decode(Odometry, out[0].payload) for out in result]
    assert odometry[0].frame == odometry[1].frame == "odom"


def test_wire_command_moves_robot_and_odometry_drifts() -> None:
    team = InPhysics(PAIR)
    hosted, outbox = team.fleet.world, []
    command = Sample("robot1/cmd_vel", encode(TwistStamped(EPOCH, 0.1, 0.3)), None, 0.0)
    for number in range(501):
        outbox += hosted.step(at(0.01 * number), [command] if number == 0 else [])
    odometry = decode(Odometry, [out.payload for out in outbox if out.key == "robot1/odom"][-1])
    truth = decode(Pose, [out.payload for out in outbox if out.key == "robot1/ground_truth"][-1])
    start = PAIR.robots["robot1"].start
    counted = start.position + odometry.position * start.heading
    assert odometry.speed == pytest.approx(0.1, rel=0.02)
    assert abs(truth.position - start.position) > 0.2
    assert 0.0 < abs(truth.position - counted) < 0.02


def test_external_pose_is_true_pose() -> None:
    text, name = read("turtlebot3_pair")
    mission = parse(text.replace('odometry_frame = "start"', 'localisation = "external"'), name)
    team = InPhysics(mission)
    outbox = team.fleet.world.step(at(0.0), [])
    seen = decode(Pose, next(out.payload for out in outbox if out.key == "robot1/pose"))
    assert seen.position == pytest.approx(mission.robots["robot1"].start.position, abs=1e-3)


def test_standing_robot_does_not_move_during_long_pause() -> None:
    world = World(PAIR)
    hosted = InPhysics(PAIR).fleet.world
    hosted.step(at(0.0), [])
    hosted.step(at(3600.0), [])
    assert hosted.plant("robot1").position == pytest.approx(world.states["robot1"].position, abs=1e-3)


def test_wire_scan_contains_obstacles_of_physics_world() -> None:
    text, name = read("six_robots")
    text = text.replace("[robot]", '[robot]\nscanner = "optional"', 1)
    mission = standing(parse(text, name), posts=[(-1.5 + 3.0j, 0.1)])  # robot2 at -1.5 + 2j faces it
    hosted, result = InPhysics(mission).fleet.world, []
    for number in range(30):
        result += hosted.step(at(0.01 * number), [])
    assert {key for _, key in hosted.publications} == {key for _, key in Hosted(mission).publications}
    scan = next(decode(LaserScan, out.payload) for out in result if out.key == "robot2/scan")
    assert scan.ranges[0] == pytest.approx(0.9, abs=0.1)  # noise
    assert scan.ranges[180] == 0.0  # no object
