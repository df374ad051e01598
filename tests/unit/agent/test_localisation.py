"""What an agent makes of its own odometry, message by message."""

from __future__ import annotations

import cmath
import math
import random

import pytest

from formation.agent.pose.estimator import Localisation
from formation.control.laws import LAWS
from formation.control.unicycle import Command
from formation.mission.file import load
from formation.protocol.reasons import Code
from formation.ros2.messages import Odometry, Pose
from formation.wire import Now
from tests.support.missions import team

SIX = load("six_robots")
EPOCH = 1.7e9
PERIOD = 0.05


class Driver:
    """Feeds one robot's localisation, straight ahead along x unless told otherwise."""

    def __init__(self, law: str = "field") -> None:
        self.here = Localisation(SIX, "robot3", LAWS[law])
        self.mono, self.position, self.heading = 0.0, 0j, 1.0 + 0.0j

    def drive(
        self, after: float = PERIOD, *, speed: float = 0.5, move: complex = 0j, turn: float = 0.0
    ) -> float | None:
        self.mono += after
        self.heading *= cmath.rect(1.0, turn)
        self.position += speed * after * self.heading + move
        message = Odometry(EPOCH + self.mono, self.position, self.heading, speed, 0.0)
        return self.here.update_pose(message, self.mono, Now(self.mono, EPOCH + self.mono))


@pytest.fixture
def driver() -> Driver:
    driver = Driver()
    for _ in range(40):
        driver.drive()
    assert driver.here.state.follows
    assert abs(driver.here.heading - 1.0) < 0.01
    return driver


def test_the_first_message_opens_an_interval_and_the_second_closes_it() -> None:
    driver = Driver()
    assert driver.drive() is None
    assert not driver.here.state.follows
    assert driver.drive() == pytest.approx(PERIOD, abs=1e-6)
    assert driver.here.state.follows


@pytest.mark.parametrize("gap", [0.2, 0.9, 1.1])
def test_after_gap_heading_needs_a_complete_interval(driver: Driver, gap: float) -> None:
    assert driver.drive(gap) is None
    assert driver.here.state.jumped is None
    assert not driver.here.state.follows
    driver.drive()
    assert driver.here.state.follows


@pytest.mark.parametrize("gap", [PERIOD, 0.4, 1.1])
def test_jump_is_detected_in_time_and_after_gap(driver: Driver, gap: float) -> None:
    assert driver.drive(gap, move=5.0 + 0.0j) is None
    assert driver.here.state.jumped is not None
    assert driver.here.state.jumped.code is Code.POSITION_JUMPED
    for _ in range(2):
        driver.drive()
        assert driver.here.state.jumped is not None
    for _ in range(2):
        driver.drive()
    assert driver.here.state.jumped is None


def test_gyroscope_reset_jumps_without_changing_estimated_heading(driver: Driver) -> None:
    before = driver.here.heading
    assert driver.drive(turn=math.pi / 2.0, move=0.025 - 0.025j) is None
    assert str(driver.here.state.jumped) == "odometry jumped by +1.57 rad"
    assert driver.here.heading == before


@pytest.mark.parametrize("law", LAWS)
def test_impossible_speed_does_not_change_estimated_heading(law: str) -> None:
    driver = Driver(law)
    for _ in range(40):
        driver.drive()
    before = driver.here.heading
    assert driver.drive(speed=-1e3, move=1e3 * PERIOD + 0.025) is None
    assert driver.here.state.jumped is not None
    assert driver.here.heading == before


def test_turning_at_maximum_rate_is_no_jump(driver: Driver) -> None:
    for _ in range(40):
        driver.drive(turn=1.5 * PERIOD)
        assert driver.here.state.jumped is None


def test_the_printed_observer_stays_a_number_however_far_a_robot_reverses() -> None:
    driver = Driver("paper")
    for _ in range(4000):
        driver.drive(speed=-1.5)
        assert cmath.isfinite(driver.here.state.estimate)
    assert abs(driver.here.heading) == pytest.approx(1.0)


def test_wheels_that_stand_teach_nothing_and_the_collision_filter_knows_it() -> None:
    here, noise = (
        Localisation(team({"robot1": ("leader",)}, localisation="external"), "robot1", LAWS["field"]),
        random.Random(1),
    )
    faces, position, moment = cmath.rect(1.0, 2.5), 0j, 0.0

    def drive(seconds: float, speed: float) -> None:
        nonlocal position, moment
        for _ in range(round(seconds * 20)):
            moment += 0.05
            position += speed * 0.05 * faces
            seen = position + complex(noise.gauss(0.0, 1e-3), noise.gauss(0.0, 1e-3))
            here.update_pose(Pose(1.7e9 + moment, seen, 1.0 + 0.0j), moment, Now(moment, 1.7e9 + moment))
            here.commanded(moment, Command(0.5, 0.0))

    def wrong() -> float:
        return abs(cmath.phase(here.course / faces))

    drive(2.0, 0.0)  # blocked, though told to drive
    assert here.course_doubt == math.pi
    for _ in range(40):
        drive(0.05, 0.5)
        assert wrong() <= here.course_doubt
    assert here.course_doubt < 0.2
    for _ in range(40):
        drive(0.05, 0.0)
        assert wrong() <= here.course_doubt
    assert here.course_doubt == math.pi
