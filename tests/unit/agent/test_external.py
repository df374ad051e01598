"""Robots that are localised by external poses instead of odometry."""

from __future__ import annotations

import cmath
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from formation.agent.core import Agent
from formation.control.plane import angle_between
from formation.mission.model import Mission
from formation.protocol.reasons import Code
from formation.ros2.messages import Pose, decode, encode
from formation.topics import ODOM, POSE, POSITION
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import altered, lost, on
from tests.support.missions import with_robots

STEPS = {"speed_step": 0.01, "turn_rate_step": 0.01}
SEEN = with_robots("turtlebot3_pair", localisation="external", **STEPS)
MEASURED = with_robots("turtlebot3_pair", localisation="external", heading="measured", **STEPS)
SIX = with_robots("six_robots", localisation="external")
AT_REST = (0.0, 0.0)
both = pytest.mark.parametrize("mission", [SEEN, MEASURED], ids=["observer", "measured"])


def heading_error(fleet: Fleet, name: str) -> float:
    """Error of the agent's heading [rad]."""
    return abs(float(angle_between(fleet.world.plant(name).heading, fleet.agents[name].here.heading)))


def test_agent_with_external_pose_ignores_odometry() -> None:
    keys = set(Agent(SEEN, "robot1").subscriptions)
    assert keys == {POSE.key("robot1"), POSITION.key("leader")}
    assert ODOM.key("robot1") in {key for _, key in Fleet(SEEN).world.publications}


@pytest.mark.slow
@pytest.mark.parametrize("mission", [SEEN, MEASURED, SIX], ids=["observer", "measured", "six"])
def test_robots_with_external_pose_come_into_formation(mission: Mission) -> None:
    fleet = Fleet(mission).after(30.0)
    assert fleet.error() < 0.005
    assert max(heading_error(fleet, name) for name in mission.followers) < 0.02


@pytest.mark.slow
@both
def test_robots_keep_formation_with_noisy_late_camera(mission: Mission) -> None:
    fleet, dice = Fleet(mission), np.random.default_rng(8)

    def camera(sample: Sample) -> tuple[Sample]:
        if not sample.key.endswith("/pose"):
            return (sample,)
        seen = decode(Pose, sample.payload)
        off, turned = 0.002 * complex(*dice.normal(size=2)), cmath.rect(1.0, 0.02 * dice.normal())
        payload = encode(replace(seen, position=seen.position + off, heading=seen.heading * turned))
        return (sample._replace(payload=payload, arrived=sample.arrived + 0.1),)

    fleet.meddle = camera
    fleet.run(30.0)
    assert max(fleet.errors(10.0)) < 0.02


def test_heading_observer_ignores_orientation_of_external_pose() -> None:
    plain, twisted = Fleet(SEEN), Fleet(SEEN)
    twisted.meddle = altered(POSE.key("robot1"), Pose, lambda seen: replace(seen, heading=1j))
    for fleet in (plain, twisted):
        fleet.run(5.0)
    assert plain.commands["robot1"] == twisted.commands["robot1"]


def test_silent_external_pose_stops_robot_until_it_returns() -> None:
    fleet = Fleet(SEEN).after(5.0)
    fleet.meddle = lost(POSE.key("robot1"))
    fleet.run(3 * 0.05 + 0.06)
    assert fleet.last_command("robot1") == AT_REST
    assert fleet.status("robot1").reason.code is Code.POSITION_SILENT
    fleet.meddle = lambda sample: (sample,)
    fleet.run(15.0)
    assert fleet.error() < 0.01


@pytest.mark.parametrize("mission", [*slow(SEEN), MEASURED], ids=["observer", "measured"])
def test_jump_of_external_pose_stops_robot_without_lurch(mission: Mission) -> None:
    fleet = Fleet.under_way(mission, 20.0)
    fleet.meddle = altered(POSE.key("robot1"), Pose, lambda seen: replace(seen, position=seen.position - 1j))
    fleet.run(0.1)
    assert fleet.last_command("robot1") == AT_REST
    assert str(fleet.status("robot1").reason).startswith("pose jumped")
    fleet.meddle = lambda sample: (sample,)
    fleet.run(10.0)
    for name in mission.followers:
        assert max(abs(speed) for speed, _ in fleet.commands_since(name, 20.0)) <= 0.12
    assert fleet.error() < 0.005


@pytest.mark.parametrize("scale", [3.0, *slow(2.0, 10.0)])
def test_camera_with_wrong_scale_stops_its_robots(scale: float) -> None:
    """They would drive at a third of their distances."""
    fleet = Fleet(SEEN)

    def scaled(sample: Sample) -> tuple[Sample]:
        if not sample.key.endswith("/pose"):
            return (sample,)
        seen = decode(Pose, sample.payload)
        return (sample._replace(payload=encode(replace(seen, position=scale * seen.position))),)

    fleet.meddle = scaled
    fleet.run(10.0)
    for name in fleet.mission.followers:
        assert fleet.plant(name).path < 0.4
        assert fleet.status(name).reason.code is Code.MOTION_CARRIED
        assert "scale of the pose" in str(fleet.status(name).reason)


@pytest.mark.parametrize(("warm", "state"), [(0.0, "waiting"), *slow((12.0, "hold"))])
def test_refused_poses_are_named_instead_of_a_silence(warm: float, state: str) -> None:
    """A camera that measures no orientation may send a quaternion of zeros."""
    fleet = Fleet.under_way(SEEN, warm) if warm else Fleet(SEEN)
    zeros = bytes(4 * 8)
    fleet.meddle = on(
        POSE.key("robot1"), lambda sample: (sample._replace(payload=sample.payload[: -len(zeros)] + zeros),)
    )
    fleet.run(2.0)
    assert fleet.last_command("robot1") == AT_REST
    status = fleet.status("robot1")
    assert (status.state, status.reason.code) == (state, Code.POSITION_REFUSED)
    assert str(status.reason).endswith("orientation has length 0, must be 1")
    fleet.meddle = lost(POSE.key("robot1"))
    fleet.run(2.0)
    silent = Code.POSITION_SILENT if warm else Code.NO_POSITION
    assert fleet.status("robot1").reason.code is silent
    fleet.meddle = lambda sample: (sample,)
    fleet.run(2.0)
    assert fleet.status("robot1").state == "run"


def mirrored(seen: Pose) -> Pose:
    return replace(seen, position=seen.position.conjugate(), heading=seen.heading.conjugate())


@pytest.mark.parametrize("warm", [0.0, *slow(12.0)])
def test_mirrored_camera_stops_robot_until_hold_and_run(warm: float) -> None:
    """It turned away from where it wanted to go: 2.4 m in 25 s, and never stopped."""
    fleet = Fleet.under_way(SEEN, warm) if warm else Fleet(SEEN)
    fleet.meddle = altered(POSE.key("robot1"), Pose, mirrored)
    assert fleet.driven("robot1", 10.0) < 0.5
    assert fleet.status("robot1").reason.code is Code.PATH_MIRRORED
    assert fleet.last_command("robot1") == AT_REST
    fleet.meddle = lambda sample: (sample,)
    fleet.run(2.0)
    assert fleet.last_command("robot1") == AT_REST
    fleet.ask("leader", "hold")
    fleet.run(1.0)
    fleet.ask("leader", "run")
    fleet.run(25.0)
    assert fleet.error() < 0.01


def test_measured_heading_comes_from_odometry_at_once() -> None:
    fleet = Fleet(with_robots("turtlebot3_pair", heading="measured", odometry_frame="start")).after(0.3)
    for name in fleet.mission.followers:
        assert heading_error(fleet, name) < 0.02
    fleet.run(20.0)
    assert fleet.error() < 0.02


@pytest.mark.parametrize("heading", ["observer", *slow("measured")])
def test_heading_stays_accurate_with_rare_positions(heading: str) -> None:
    # a ramp restarts after each gap: it would slow down a robot that stops twice a second
    fleet = Fleet(with_robots("turtlebot3_pair", localisation="external", heading=heading, ramp=0.0))
    count = itertools.count()
    fleet.meddle = on(
        POSE.key("robot1"), lambda one: () if next(count) % 3 else (one,)
    )  # three periods apart
    fleet.run(30.0)
    assert heading_error(fleet, "robot1") < 0.1
    assert fleet.error() < 0.1


@pytest.mark.slow
@both
def test_frozen_camera_position_stops_robot(mission: Mission) -> None:
    fleet = Fleet.under_way(mission, 20.0)
    frozen: dict[str, Pose] = {}
    fleet.meddle = altered(
        POSE.key("robot1"), Pose, lambda seen: replace(frozen.setdefault("robot1", seen), stamp=seen.stamp)
    )
    assert fleet.driven("robot1", 10.0) < 0.15
    assert fleet.last_command("robot1") == AT_REST
    assert fleet.status("robot1").reason.code is Code.MOTION_FROZEN
    fleet.meddle = lambda sample: (sample,)
    fleet.run(40.0)
    assert fleet.status("robot1").state == "run"
    assert fleet.error() < 0.01


@pytest.mark.slow
def test_flipped_measured_heading_stops_robot() -> None:
    fleet = Fleet.under_way(MEASURED, 20.0)
    fleet.meddle = altered(POSE.key("robot1"), Pose, lambda seen: replace(seen, heading=-seen.heading))
    driven = fleet.driven("robot1", 0.1)
    assert fleet.last_command("robot1") == AT_REST
    assert "rad" in str(fleet.status("robot1").reason)
    assert driven + fleet.driven("robot1", 9.9) < 0.3
    assert fleet.last_command("robot1") == AT_REST
    assert "heading" in str(fleet.status("robot1").reason)
    fleet.meddle = lambda sample: (sample,)
    fleet.run(20.0)
    assert fleet.status("robot1").state == "run"
    assert fleet.error() < 0.01


@pytest.mark.slow
def test_order_to_hold_and_run_ends_a_contradicted_heading() -> None:
    fleet = Fleet.under_way(MEASURED, 5.0)
    here = fleet.agents["robot1"].here.state
    here.estimate = -here.measured
    for do, code in (("", Code.HEADING_CONTRADICTED), ("hold", Code.HELD_BY_LEADER), ("run", Code.RUNNING)):
        if do:
            assert fleet.ask("leader", do).ok
        fleet.run(3.0)
        assert fleet.status("robot1").reason.code is code


@pytest.mark.parametrize("degrees", [50, *slow(-60, 110, 180, -140)])
def test_wrongly_mounted_marker_is_detected_within_half_metre(degrees: float) -> None:
    off = cmath.rect(1.0, math.radians(degrees))
    fleet = Fleet(MEASURED)
    fleet.meddle = altered(POSE.key("robot1"), Pose, lambda seen: replace(seen, heading=seen.heading * off))
    fleet.run(20.0)
    assert fleet.last_command("robot1") == AT_REST
    assert "heading" in str(fleet.status("robot1").reason)
    assert fleet.plant("robot1").path < 0.5


@pytest.mark.parametrize("ahead", [0.1, *slow(-0.05, -0.08)])
def test_marker_at_rim_of_robot_does_not_contradict_heading(ahead: float) -> None:
    """In tight curves it moves up to 58° from where the robot faces."""
    fleet = Fleet(MEASURED)
    fleet.meddle = altered(
        POSE.key("robot1"), Pose, lambda seen: replace(seen, position=seen.position + ahead * seen.heading)
    )
    for _ in range(20):
        fleet.run(1.0)
        assert fleet.status("robot1").reason.code is not Code.HEADING_CONTRADICTED


@pytest.mark.parametrize("degrees", [90, *slow(180)])
def test_measured_heading_may_differ_from_start_heading(degrees: float) -> None:
    fleet = Fleet(MEASURED)
    fleet.plant("robot1").heading *= cmath.rect(1.0, math.radians(degrees))
    fleet.run(20.0)
    assert fleet.error() < 0.01
