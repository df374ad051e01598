"""The paper's missions with wheels that slip: production cores, a fake clock, no processes."""

from __future__ import annotations

import math
from statistics import fmean

import pytest

from tests.support import needs

pytestmark = pytest.mark.physics
needs.leave_out_without("physics")

from formation.agent.simulated.physics.world import World  # noqa: E402 - only where there is MuJoCo
from formation.agent.simulated.simulated import World as Hosted  # noqa: E402
from formation.deploy.testing.rehearsed import RehearsedFleet  # noqa: E402
from formation.mission.file import parse, read  # noqa: E402
from formation.mission.model import Mission  # noqa: E402
from formation.ros2.messages import LaserScan, Odometry, Pose, TwistStamped, decode, encode  # noqa: E402
from formation.wire import Sample  # noqa: E402
from tests.support.fleet import EPOCH, at  # noqa: E402
from tests.support.physics_worlds import (  # noqa: E402
    PAIR,
    SIX,
    InPhysics,
    at_random,
    beside_its_slots,
    standing,
)


@pytest.mark.slow
@pytest.mark.parametrize(("mission", "spread"), [(PAIR, 0.4), (SIX, 2.0)])
@pytest.mark.parametrize("seed", [1, 3])
def test_the_papers_missions_hold_their_formation_within_three_centimetres_of_truth(
    mission: Mission, spread: float, seed: int
) -> None:
    team = InPhysics(beside_its_slots(mission, seed, spread), seed)
    team.errors(20.0)
    errors = team.errors(10.0)
    assert math.sqrt(fmean(error**2 for error in errors)) < 0.03
    assert not team.world.touched


def test_convoy_finds_its_robots_by_what_stands_at_their_scanners() -> None:
    fleet = RehearsedFleet("convoy", world="mujoco")
    fleet.run(6.0)
    assert {fleet.state(name) for name in fleet.mission.followers} == {"run"}


@pytest.mark.slow
@pytest.mark.parametrize(("mission", "start"), [(SIX, 7), (PAIR, 8)])
def test_robots_with_mass_that_would_run_into_each_other_keep_apart(mission: Mission, start: int) -> None:
    avoiding = {name: one.model_copy(update={"avoid": "all"}) for name, one in mission.robots.items()}
    mission = mission.changed(robots=avoiding)
    off = mission.model_copy(update={"collisions": mission.collisions.model_copy(update={"mode": "off"})})
    rash, careful = (InPhysics(at_random(one, 20, 1)[start], start) for one in (off, mission))
    rash.fleet.run(5.0)
    assert rash.world.touched
    careful.fleet.run(15.0)
    errors = careful.errors(10.0)
    assert not careful.world.touched
    assert careful.world.nearest > 0.0
    assert math.sqrt(fmean(error**2 for error in errors)) < 0.03


def test_robots_in_physics_say_the_same_on_the_same_keys() -> None:
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


def test_a_camera_above_sees_the_truth() -> None:
    text, name = read("turtlebot3_pair")
    mission = parse(text.replace('odometry_frame = "start"', 'localisation = "external"'), name)
    team = InPhysics(mission)
    outbox = team.fleet.world.step(at(0.0), [])
    seen = decode(Pose, next(out.payload for out in outbox if out.key == "robot1/pose"))
    assert seen.position == pytest.approx(mission.robots["robot1"].start.position, abs=1e-3)


def test_a_process_that_was_frozen_goes_on_where_it_was() -> None:
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
    assert scan.ranges[180] == 0.0  # nothing there
