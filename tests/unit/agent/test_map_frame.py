"""Placement of odometry in a map by a localiser such as AMCL: rare, late, noisy and wrong poses."""

from __future__ import annotations

import cmath
import json
import math
import re
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.core import Agent
from formation.agent.persistence.state import Codec
from formation.agent.pose.estimator import Localisation
from formation.agent.pose.map_frame import (
    AGREEMENT_TIME,
    HISTORY_TIME,
    JUMP_AGREEMENTS,
    MAX_DEVIATION,
    MAX_JUMPS,
    MAX_UNCORRECTED_DISTANCE,
    STANDING_TIME,
    MapFrame,
    MapFrameState,
    Placement,
)
from formation.agent.pose.sources import MAX_ALIGN_SPEED
from formation.control.laws import LAWS
from formation.control.plane import unit
from formation.control.unicycle import AT_REST
from formation.protocol.reasons import Code, Reason
from formation.ros2.messages import MapPose, Odometry, Pose, Transform, Transforms, decode, encode
from formation.topics import AMCL_POSE, ODOM, POSITION, TF
from formation.wire import BadMessage, Sample
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet, at
from tests.support.meddling import altered, lost, on
from tests.support.missions import with_robots

PERIOD = 0.05
TRUE = Placement(cmath.rect(1.0, 0.7), 3.0 - 2.0j)
PAIR = with_robots("turtlebot3_pair", odometry_frame="map")


class Drive:
    """A robot at 0.2 m/s with exact odometry; the test sends the localiser's messages."""

    def __init__(self) -> None:
        self.frame, self.time, self.at, self.heading = MapFrame(), 100.0, 0j, 1.0 + 0.0j
        self.step()

    def step(self, speed: float = 0.0) -> None:
        self.time += PERIOD
        self.at += speed * PERIOD * self.heading
        odometry = Odometry(self.time, self.at, self.heading, speed, 0.0, frame="odom")
        self.frame.moved(odometry, None)

    def go(self, distance: float, speed: float = 0.2) -> None:
        for _ in range(round(distance / speed / PERIOD)):
            self.step(speed)

    def pose(
        self, true: Placement = TRUE, late: float = 0.0, off: complex = 0j, **deviations: Any
    ) -> MapPose:
        """A pose of `late` [s] ago, while the robot drove at 0.2 m/s."""
        at = self.at - 0.2 * late * self.heading
        return MapPose(self.time - late, true.of(at) + off, true.rotation * self.heading, **deviations)

    def receive(self, placement: Placement, ahead: float = 1.0) -> Reason | None:
        """Receive a transform, stamped `ahead` [s] as by AMCL."""
        one = Transform(self.time + ahead, "map", "odom", placement.origin, placement.rotation)
        return self.frame.take_transforms(Transforms((one,)), "map", "odom")

    @property
    def placed(self) -> Placement:
        assert self.frame.state.placement is not None
        return self.frame.state.placement

    def doubted(self) -> Code | None:
        doubt = self.frame.doubt
        return None if doubt is None else doubt.code


def placement_error(one: Placement, other: Placement, at: complex) -> float:
    return abs(one.of(at) - other.of(at))


@pytest.fixture
def drive() -> Drive:
    """A robot after a first pose by its localiser."""
    drive = Drive()
    drive.frame.take_pose(drive.pose())
    return drive


@given(late=st.floats(0.0, 0.9 * HISTORY_TIME), heading=st.floats(-3.0, 3.0), distance=st.floats(0.5, 3.0))
def test_late_pose_is_compared_with_odometry_of_its_time(
    late: float, heading: float, distance: float
) -> None:
    drive = Drive()
    drive.heading = cmath.rect(1.0, heading)
    drive.go(distance + 1.0)
    drive.frame.take_pose(drive.pose(late=late))
    assert placement_error(drive.placed, TRUE, drive.at) < 1e-9


@pytest.mark.parametrize(
    ("pose", "why"),
    [
        ({"late": 2.5}, r"2\.50 s before the newest odometry; limit 1 s"),
        ({"deviation": 0.5}, "pose uncertain by"),
        ({"heading_deviation": 0.5}, "pose uncertain by"),
    ],
    ids=["late", "position", "heading"],
)
def test_late_or_uncertain_pose_is_refused(pose: dict[str, Any], why: str) -> None:
    drive = Drive()
    drive.go(1.0)
    with pytest.raises(BadMessage, match=why):
        drive.frame.take_pose(drive.pose(**pose))


def test_pose_from_before_a_turn_and_repeated_pose_are_refused() -> None:
    drive = Drive()
    before = drive.pose()
    drive.heading *= cmath.rect(1.0, 0.4)
    drive.step()
    with pytest.raises(BadMessage, match=r"moved 0\.00 m, 0\.40 rad since; limits 0\.3 m, 0\.3 rad"):
        drive.frame.take_pose(before)
    pose = drive.pose()
    drive.frame.take_pose(pose)
    with pytest.raises(BadMessage, match="before the newest"):
        drive.frame.take_pose(pose)


@pytest.mark.parametrize("lag", [0.5, 0.9, 1.9])
@pytest.mark.parametrize("speed", [0.2, 0.8])
def test_wrong_clock_shifts_placement_by_bounded_distance(drive: Drive, lag: float, speed: float) -> None:
    for _ in range(100):
        drive.go(0.2, speed)
        with suppress(BadMessage):
            drive.frame.take_pose(replace(drive.pose(), stamp=drive.time - lag))
        assert placement_error(drive.placed, TRUE, drive.at) <= MAX_DEVIATION
    refused = lag > HISTORY_TIME or lag * speed > MAX_DEVIATION
    assert (drive.doubted() is Code.LOCALISER_SILENT) == refused


def test_noisy_bursts_of_poses_keep_placement(drive: Drive) -> None:
    draw = np.random.default_rng(1)
    for _ in range(40):
        drive.go(0.25)
        for _ in range(int(draw.integers(1, 4))):  # bursts, as of AMCL
            drive.step(0.2)
            noise = 0.03 * complex(*draw.normal(size=2))
            pose = drive.pose(late=float(draw.uniform(0.05, 0.4)), off=noise)
            with suppress(BadMessage):  # the pose was overtaken within the burst
                assert drive.frame.take_pose(pose) is None
        assert placement_error(drive.placed, TRUE, drive.at) < 0.15
    assert drive.doubted() is None


@pytest.mark.parametrize(
    ("tremble", "distance", "speed", "count"),
    [(0.0, 0.25, 0.2, 19), (1e-6, 0.25, 0.2, 19), (0.01, 0.25, 0.2, 19), (1e-3, 0.005, 0.1, 900)],
    ids=["exact", "tremble 1e-6", "tremble 0.01", "high rate"],
)
def test_frozen_localiser_keeps_placement_and_counts_as_silent(
    tremble: float, distance: float, speed: float, count: int
) -> None:
    drive, draw = Drive(), np.random.default_rng(2)
    first = drive.pose()
    drive.frame.take_pose(first)
    for _ in range(count):
        drive.go(distance, speed)
        wobble = tremble * complex(*draw.normal(size=2))
        try:
            assert drive.frame.take_pose(MapPose(drive.time, first.position + wobble, first.heading)) is None
        except BadMessage:
            assert tremble == 0.0
    assert placement_error(drive.placed, TRUE, drive.at) < 0.5
    drive.go(1.0)
    assert drive.doubted() is Code.LOCALISER_SILENT


def test_silent_localiser_is_doubted_after_max_distance(drive: Drive) -> None:
    drive.go(MAX_UNCORRECTED_DISTANCE - 0.1)
    assert drive.doubted() is None
    drive.go(0.2)
    assert drive.doubted() is Code.LOCALISER_SILENT
    drive.frame.take_pose(drive.pose())
    assert drive.doubted() is None


def test_relocalisation_needs_agreement_and_is_limited_in_number(drive: Drive) -> None:
    for number in range(MAX_JUMPS):
        moved, taken = TRUE._replace(origin=TRUE.origin + number + 1.0), []
        for _ in range(JUMP_AGREEMENTS + 1):
            drive.go(0.1)
            taken.append(drive.frame.take_pose(drive.pose(moved)))
        assert taken[:-1] == [None] * JUMP_AGREEMENTS
        assert taken[-1] is not None
        assert taken[-1].code is Code.RELOCALISED
        assert taken[-1].values["distance"] == pytest.approx(1.0)
    assert drive.doubted() is Code.LOCALISER_JUMPS
    drive.frame.trust()  # an operator has checked the position
    assert drive.doubted() is None


def test_map_transform_places_odometry() -> None:
    drive = Drive()
    wheel = Transform(1.0, "base_link", "wheel", 0.1j, 1.0)
    placed = Transform(1.0, "/map", "odom", TRUE.origin, TRUE.rotation)
    message = decode(Transforms, encode(Transforms((wheel, placed))))
    assert drive.frame.take_transforms(message, "map", "odom") is None
    assert placement_error(drive.placed, TRUE, 5.0) < 1e-9
    assert drive.frame.take_transforms(Transforms((wheel,)), "map", "odom") is None


MOVED = TRUE._replace(origin=TRUE.origin + 2j)


@pytest.mark.parametrize("speed", [0.0, 0.2, 0.8])
def test_repeated_transform_does_not_relocalise(speed: float) -> None:
    drive = Drive()
    drive.receive(TRUE)
    for _ in range(100):
        drive.step(speed)
        assert drive.receive(MOVED) is None
    assert drive.placed == TRUE


def test_relocalisation_by_transforms_is_taken_after_two_updates() -> None:
    """AMCL repeats each update until the robot has moved by 0.25 m."""
    drive, taken = Drive(), []
    drive.receive(TRUE)
    for update in range(3):
        moved = MOVED._replace(origin=MOVED.origin + 0.01 * update)
        for _ in range(25):
            drive.step(0.2)
            taken.append(drive.receive(moved))
    assert [number for number, jump in enumerate(taken) if jump is not None] == [50]
    assert placement_error(drive.placed, MOVED, drive.at) < 0.03


def test_repeated_transform_counts_as_silent_localiser() -> None:
    drive = Drive()
    for _ in range(27):
        assert drive.receive(TRUE) is None
        drive.go(0.2)
    assert drive.doubted() is Code.LOCALISER_SILENT


def test_transform_whose_stamp_does_not_rise_is_refused() -> None:
    drive = Drive()
    drive.receive(TRUE, ahead=100.0)
    for ahead in (100.0, 20.0, -10.0):
        drive.go(0.2)
        with pytest.raises(BadMessage, match="before the newest"):
            drive.receive(MOVED, ahead - (drive.time - 100.0))
    assert drive.frame.state.suspect is None


def test_localiser_with_clock_set_back_is_accepted_again() -> None:
    drive, accepted = Drive(), 0
    drive.receive(TRUE, ahead=3600.0)
    drive.go(1.0)
    for _ in range(3):
        with suppress(BadMessage):
            drive.receive(TRUE._replace(origin=TRUE.origin + 0.01))
            accepted += 1
        drive.step()
    assert accepted == 2


def test_robot_with_clock_set_back_accepts_localiser(drive: Drive) -> None:
    drive.receive(TRUE)
    drive.time = 50.0
    drive.step()
    drive.frame.take_pose(drive.pose(off=0.01))
    assert drive.receive(TRUE._replace(origin=TRUE.origin + 0.02)) is None
    assert drive.placed.origin == TRUE.origin + 0.02


@pytest.mark.parametrize("speed", [0.0, 0.2, 0.8])
def test_short_localiser_error_at_high_rate_is_no_jump(drive: Drive, speed: float) -> None:
    for _ in range(round(2 * AGREEMENT_TIME / PERIOD)):
        drive.step(speed)
        assert drive.frame.take_pose(drive.pose(MOVED, off=drive.time * 1e-6)) is None
        assert drive.receive(MOVED._replace(origin=MOVED.origin + drive.time * 1e-6)) is None
    assert placement_error(drive.placed, TRUE, drive.at) < 0.01


def test_standing_robot_is_relocalised_by_new_poses() -> None:
    drive, taken = Drive(), None
    drive.frame.take_pose(drive.pose())
    while taken is None and drive.time < 110.0:
        drive.step()
        taken = drive.frame.take_pose(drive.pose(MOVED, off=drive.time * 1e-6))
    assert 2 * STANDING_TIME < drive.time - 100.0 < 2 * STANDING_TIME + 0.2


def test_map_frame_state_is_restored_exactly() -> None:
    drive, codec = Drive(), Codec(MapFrameState)
    drive.receive(TRUE)
    drive.frame.take_pose(drive.pose(MOVED))
    drive.step()
    drive.time = 50.0
    drive.step()
    drive.receive(MOVED)
    drive.frame.state.outdated = TRUE
    assert codec.read(json.dumps(codec.write(drive.frame.state)).encode()) == drive.frame.state


def test_manual_pose_is_taken_by_trust(drive: Drive) -> None:
    """AMCL publishes such a pose once, and repeats its transform."""
    drive.step()
    drive.frame.take_pose(drive.pose(MOVED))
    jumps = []
    for _ in range(30):
        drive.step()
        drive.receive(MOVED)
        jumps.append(drive.frame.trust())
    assert [jump.code for jump in jumps if jump is not None] == [Code.RELOCALISED]
    assert jumps[10] is None
    assert placement_error(drive.placed, MOVED, drive.at) < 1e-9


def test_tilted_transforms_are_skipped() -> None:
    upright = Transform(1.0, "map", "odom", 1.0, 1.0)
    payload = bytearray(encode(Transforms((upright,))))
    x, w = len(payload) - 32, len(payload) - 8
    payload[x : x + 8], payload[w : w + 8] = payload[w : w + 8], payload[x : x + 8]
    assert decode(Transforms, bytes(payload)).transforms == ()


def test_map_pose_survives_encoding() -> None:
    pose = MapPose(12.5, 1.0 - 2.0j, cmath.rect(1.0, 0.3), 0.25, 0.5)
    found = decode(MapPose, encode(pose))
    assert abs(found.heading - pose.heading) < 1e-12
    assert (found.position, found.deviation, found.heading_deviation) == (pose.position, 0.25, 0.5)


def test_team_with_localiser_comes_into_formation() -> None:
    fleet = Fleet(PAIR).after(25.0)
    assert fleet.error() < 0.25  # its poses are off by 2 cm and 0.02 rad
    for name, agent in fleet.agents.items():
        assert {AMCL_POSE.key(name), TF.key(name)} < set(agent.subscriptions)


def test_restarted_odometry_keeps_position_in_map() -> None:
    """The localiser's placement of the earlier odometry is not valid for the restarted one."""
    fleet = Fleet.under_way(PAIR, 12.0)
    agent, plant = fleet.agents["robot1"], fleet.plant("robot1")
    before = abs(agent.here.state.position - plant.position)
    plant._counts_from = plant.position, plant.heading  # odometry restarts, as after its bring-up
    fleet.meddle = lost(AMCL_POSE.key("robot1"))
    fleet.run(4.0)
    assert agent.here.state.source.realigned == 1
    assert abs(agent.here.state.position - plant.position) < before + 0.03


@pytest.mark.parametrize("error", [0.0, 0.02])
def test_transform_from_before_odometry_restart_moves_nothing(error: float) -> None:
    """AMCL repeats the transform, or sends a similar one because it takes the restart for motion."""
    fleet, newest = Fleet(PAIR), [Transform(0.0, "map", "odom", 0j, 1.0)]
    draw, restarted = np.random.default_rng(4), False

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != ODOM.key("robot1"):
            return () if sample.key == AMCL_POSE.key("robot1") else (sample,)
        odometry = decode(Odometry, sample.payload)
        if not restarted:
            plant = fleet.plant("robot1")
            turn = unit(plant.heading / odometry.heading)
            newest[0] = Transform(0.0, "map", "odom", plant.position - turn * odometry.position, turn)
        off = error * complex(*draw.normal(size=2)) if restarted else 0j
        one = newest[0]._replace(stamp=odometry.stamp, position=newest[0].position + off)
        return sample, sample._replace(key=TF.key("robot1"), payload=encode(Transforms((one,))))

    fleet.meddle = meddle
    fleet.run(12.0)
    agent, plant, restarted = fleet.agents["robot1"], fleet.plant("robot1"), True
    plant._counts_from = plant.position, plant.heading
    fleet.run(4.0)
    assert agent.here.state.source.realigned == 1
    assert abs(agent.here.state.position - plant.position) < 0.03


def test_robot_holds_after_odometry_restart_during_gap() -> None:
    """The robot was carried meanwhile; it resumes when the localiser sends its pose."""
    fleet, odom, amcl = Fleet.under_way(PAIR, 12.0), ODOM.key("robot1"), AMCL_POSE.key("robot1")
    fleet.meddle = lambda sample: () if sample.key in {odom, amcl} else (sample,)
    fleet.run(2.0)
    agent, plant = fleet.agents["robot1"], fleet.plant("robot1")
    plant.position += 1j
    plant._counts_from = plant.position, plant.heading
    fleet.meddle = lost(amcl)
    fleet.run(2.0)
    assert agent.decision.reason == Reason(Code.NOT_LOCALISED)
    assert agent.command == AT_REST
    pose = encode(MapPose(agent.here.stream.state.stamp, plant.position, plant.heading))
    fleet.meddle = on(odom, lambda sample: (sample, sample._replace(key=amcl, payload=pose)))
    fleet.run(0.5)
    assert agent.here.doubt is None
    assert agent.command != AT_REST
    assert abs(agent.here.state.position - plant.position) < 0.01


def test_pose_in_frame_of_odometry_places_no_robot() -> None:
    """Such as that of a filter of odometry, remapped to the localiser's topic by mistake."""

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != ODOM.key("robot1"):
            return () if sample.key == AMCL_POSE.key("robot1") else (sample,)
        odometry = decode(Odometry, sample.payload)
        pose = MapPose(odometry.stamp, odometry.position, odometry.heading, frame="/odom")
        return sample, sample._replace(key=AMCL_POSE.key("robot1"), payload=encode(pose))

    fleet = Fleet(PAIR)
    fleet.meddle = meddle
    fleet.run(2.0)
    agent = fleet.agents["robot1"]
    assert agent.decision.reason.code is Code.LOCALISER_REFUSED
    assert "frame of odometry" in str(agent.decision.reason)
    assert agent.command == AT_REST
    assert "frame of odometry" in agent.inbox.state.last_dropped[AMCL_POSE.key("robot1")]


@pytest.mark.parametrize(
    ("late", "deviation", "why"),
    [
        (100.0, 0.02, r"stamped 100\.\d\d s before the newest odometry.*\(chrony\)"),
        (-100.0, 0.02, r"stamped \d\d\.\d\d s after the newest odometry.*\(chrony\)"),
        (0.0, 0.5, r"pose uncertain by 0\.50 m.*request_nomotion_update"),
    ],
    ids=["late clock", "early clock", "uncertain"],
)
def test_refused_first_pose_is_named_instead_of_a_missing_one(
    late: float, deviation: float, why: str
) -> None:
    fleet = Fleet(PAIR)
    fleet.meddle = altered(
        AMCL_POSE.key("robot1"),
        MapPose,
        lambda pose: replace(pose, stamp=pose.stamp - late, deviation=deviation),
    )
    fleet.run(2.0)
    assert fleet.last_command("robot1") == AT_REST
    reason = fleet.status("robot1").reason
    assert reason.code is Code.LOCALISER_REFUSED
    assert re.search(why, str(reason))
    localise(fleet)
    fleet.run(1.0)
    assert fleet.status("robot1").state == "run"


def localise(fleet: Fleet) -> None:
    """Have an exact localiser say where robot1 is, with each odometry."""

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        plant, stamp = fleet.plant("robot1"), decode(Odometry, sample.payload).stamp
        pose = encode(MapPose(stamp, plant.position, plant.heading))
        return sample, sample._replace(key=AMCL_POSE.key("robot1"), payload=pose)

    fleet.meddle = on(ODOM.key("robot1"), meddle)


@pytest.mark.parametrize("degrees", [180, *slow(90, -90, 120)])
def test_rotated_base_frame_of_localiser_holds_within_a_metre(degrees: float) -> None:
    """Before, the robot drove away from its slot, 7 m in 40 s."""
    fleet, turned = Fleet(PAIR), cmath.rect(1.0, math.radians(degrees))
    fleet.meddle = altered(
        AMCL_POSE.key("robot1"), MapPose, lambda pose: replace(pose, heading=pose.heading * turned)
    )
    fleet.run(20.0)
    assert fleet.status("robot1").reason.code is Code.LOCALISER_CONTRADICTS
    assert fleet.last_command("robot1") == AT_REST
    assert fleet.plant("robot1").path < 1.0
    localise(fleet)
    fleet.ask("leader", "hold")
    fleet.run(3.0)
    fleet.ask("leader", "run")
    fleet.run(30.0)
    assert fleet.status("robot1").state == "run"
    assert fleet.error() < 0.1


def test_two_localisers_on_one_topic_hold_the_robot() -> None:
    drive = Drive()
    drive.frame.take_pose(drive.pose())
    for number in range(1, 5):
        drive.go(0.25)
        drive.frame.take_pose(drive.pose(MOVED if number % 2 else TRUE))
    assert drive.doubted() is Code.LOCALISER_CONTRADICTS
    drive.frame.trust()
    assert drive.doubted() is None


def test_outliers_after_a_metre_of_agreement_hold_no_robot() -> None:
    drive = Drive()
    for number in range(40):
        drive.frame.take_pose(drive.pose(MOVED if number in {6, 8, 10, 30, 32} else TRUE))
        drive.go(0.25)
    assert drive.doubted() is None
    assert placement_error(drive.placed, TRUE, drive.at) < 1e-9


@pytest.mark.parametrize("off", [0j, 0.05])
def test_placement_from_before_gap_is_taken_only_by_trust(off: complex) -> None:
    """It is right only if the robot is where its earlier odometry began: an operator decides.

    An exact copy of the earlier placement is never taken.
    """
    drive = Drive()
    drive.receive(TRUE)
    drive.go(1.0)
    drive.at = 0j
    drive.time += 2.0
    drive.frame.moved(Odometry(drive.time, 0j, 1.0, 0.0, 0.0, frame="odom"), TRUE, gap=True)
    for _ in range(40):
        drive.step()
        drive.receive(TRUE._replace(origin=TRUE.origin + off))
    assert drive.doubted() is Code.NOT_LOCALISED
    assert (drive.frame.trust() is None) == (off == 0j)
    drive.step()
    drive.receive(MOVED)
    assert drive.doubted() is None


@pytest.mark.parametrize("odometry_first", [False, True])
def test_first_pose_places_odometry_of_the_same_step(odometry_first: bool) -> None:
    """The position published in that step is in the map."""
    agent, time, published = Agent(PAIR, "robot1", publisher_id="any"), 10.0, []
    for number in range(10):
        time += PERIOD
        odometry = Odometry(EPOCH + time, 1j, 1j, 0.0, 0.0, frame="odom")
        inbox = [Sample(ODOM.key("robot1"), encode(odometry), None, time)]
        if number == 5:
            pose = MapPose(EPOCH + time - (0.0 if odometry_first else PERIOD), 3.0 - 2.0j, -1.0, 0.02, 0.02)
            inbox.insert(odometry_first, Sample(AMCL_POSE.key("robot1"), encode(pose), None, time))
        out = list(agent.step(at(time), inbox))
        published += [decode(Pose, one.payload) for one in out if one.key == POSITION.key("robot1")]
        if number >= 5:
            assert abs(agent.here.heading - -1.0) < 1e-9
        else:
            assert (agent.decision.reason, agent.command) == (Reason(Code.NOT_LOCALISED), AT_REST)
    assert len(published) == 5
    assert max(abs(one.position - (3.0 - 2.0j)) for one in published) < 1e-9


@pytest.mark.parametrize("rate", [10.0, 20.0, 50.0, 200.0])
def test_odometry_of_any_rate_follows_the_localiser_within_the_speed_limit(rate: float) -> None:
    here, way, before = Localisation(PAIR, "robot1", LAWS["field"]), [], None
    for number in range(round(4.0 * rate)):
        time = 10.0 + number / rate
        here.update_pose(Odometry(EPOCH + time, 0j, 1.0 + 0.0j, 0.0, 0.0, frame="odom"), time, at(time))
        if number % round(rate / 5.0) == 1:
            off = 0j if time < 12.0 else 0.1 + 0.0j
            pose = MapPose(EPOCH + time, 3.0 + off, 1.0 + 0.0j, 0.02, 0.02)
            here.handlers[AMCL_POSE.key("robot1")](
                Sample(AMCL_POSE.key("robot1"), encode(pose), None, time), at(time)
            )
        if before is not None and time > 11.0:
            way.append(abs(here.state.position - before))
        before = here.state.position
    assert 0.05 < sum(way) <= 0.1
    assert max(way) * rate <= MAX_ALIGN_SPEED * 1.01
