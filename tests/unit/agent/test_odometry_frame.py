"""Localisation by odometry in the world frame or from the start pose, and after a jump."""

from __future__ import annotations

import cmath
import itertools
import math
import random
from dataclasses import replace

import pytest

from formation.agent.pose.estimator import Localisation
from formation.control.laws import LAWS
from formation.control.unicycle import AT_REST, Command
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.reasons import Code
from formation.protocol.status import Localised
from formation.ros2.messages import Odometry, Pose
from formation.topics import ODOM, POSITION
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet, at
from tests.support.meddling import altered, on
from tests.support.missions import team, with_robots
from tests.support.sensing import reset_odometry

PAIR = with_robots("turtlebot3_pair", odometry_frame="start", speed_step=0.01, turn_rate_step=0.01)
SIX = load("six_robots")
SIX_FROM_START = with_robots("six_robots", odometry_frame="start")
PERIOD = 0.05


class Circling:
    """Feeds a robot's localisation with odometry of circles, counted from its start."""

    def __init__(self, name: str = "robot2", speed: float = 0.1, turn_rate: float = 0.4) -> None:
        self.here = Localisation(PAIR, name, LAWS["field"])
        self.start = PAIR.robots[name].start
        self.speed, self.turn_rate = speed, turn_rate
        self.mono, self.position, self.heading = 0.0, 0j, 1.0 + 0.0j
        self.true_position, self.true_heading = self.start.position, self.start.heading

    def drive(self, after: float = PERIOD, *, times: int = 1, still: bool = False) -> None:
        speed, turn_rate = (0.0, 0.0) if still else (self.speed, self.turn_rate)
        for _ in range(times):
            self.mono += after
            half = cmath.rect(1.0, 0.5 * turn_rate * after)
            self.position += speed * after * half * self.heading
            self.heading *= half * half
            self.true_position += speed * after * half * self.true_heading
            self.true_heading *= half * half
            message = Odometry(EPOCH + self.mono, self.position, self.heading, speed, turn_rate)
            self.here.update_pose(message, self.mono, at(self.mono))

    def restart_odometry(self) -> None:
        self.position, self.heading = 0j, 1.0 + 0.0j

    @property
    def error(self) -> float:
        return abs(self.here.state.position - self.true_position)

    @property
    def heading_error(self) -> float:
        return abs(cmath.phase(self.here.state.measured / self.true_heading))


def test_restarted_agent_recovers_pose_from_odometry_since_start() -> None:
    driver = Circling()
    driver.drive(times=60)
    assert driver.error < 1e-9
    assert driver.heading_error < 1e-9
    assert driver.here.state.jumps == 0
    driver.here = Localisation(PAIR, "robot2", LAWS["field"])
    driver.drive()
    assert driver.error < 1e-9
    assert abs(driver.here.heading - driver.true_heading) < 1e-9
    assert abs(driver.true_heading - PAIR.first_heading("robot2")) > 0.1


@pytest.mark.parametrize(
    ("far", "way", "turn"),
    [*itertools.product([0.02, 0.05, 0.5, 5.0], [0, 90, 180, 270], [0.0, 0.2, math.pi]), (0.0, 0, 0.2)],
)
def test_odometry_jump_while_driving_keeps_pose(far: float, way: float, turn: float) -> None:
    driver = Circling()
    driver.drive(times=60)
    driver.position += cmath.rect(far, math.radians(way))
    driver.heading *= cmath.rect(1.0, turn)
    driver.drive()
    assert driver.here.state.jumped
    driver.drive(times=60)
    assert [driver.here.state.jumped, driver.here.state.jumps] == [None, 1]
    assert driver.error < 1e-3
    assert driver.heading_error < 1e-3


def test_turn_during_odometry_jump_keeps_estimated_heading() -> None:
    driver = Circling(turn_rate=2.0)
    driver.drive(times=400)
    assert abs(cmath.phase(driver.here.heading / driver.true_heading)) < 1e-3
    driver.restart_odometry()
    driver.drive()  # by 0.1 rad
    assert driver.here.state.jumps == 1
    assert abs(cmath.phase(driver.here.heading / driver.true_heading)) < 1e-3


@pytest.mark.parametrize("silence", [0.2, 3.0, 60.0])
def test_odometry_restart_after_silence_keeps_pose(silence: float) -> None:
    driver = Circling()
    driver.drive(times=60)
    driver.drive(times=10, still=True)
    driver.restart_odometry()
    driver.drive(silence, still=True)
    assert driver.here.state.jumps == 1
    driver.drive(times=60)
    assert driver.here.state.jumped is None
    assert driver.error < 1e-3


@pytest.mark.parametrize("silence", [0.2, 1.0])
def test_driving_during_odometry_silence_is_no_jump(silence: float) -> None:
    driver = Circling()
    driver.drive(times=60)
    driver.drive(silence)
    driver.drive(times=5)
    assert driver.here.state.jumps == 0
    assert driver.error < 1e-8  # the filter loses its first guess as the robot moves


@pytest.mark.parametrize("slow", [0.0, 0.05])
def test_driving_at_limits_is_no_jump(slow: float) -> None:
    driver = Circling()
    for number in range(400):
        driver.speed, driver.turn_rate = ((0.2108, 2.635), (slow, -2.635), (-0.2108, 0.0))[number // 7 % 3]
        driver.drive(PERIOD * (1 + number % 3))
    assert driver.here.state.jumps == 0


def test_world_frame_position_follows_odometry_after_jump() -> None:
    mission = with_robots("turtlebot3_pair", odometry_frame="world")
    here = Localisation(mission, "robot2", LAWS["field"])
    for number, x in enumerate([0.0, 0.0, 5.0, 5.0]):
        mono = PERIOD * number
        here.update_pose(Odometry(EPOCH + mono, x, 1 + 0j, 0.0, 0.0), mono, at(mono))
    assert here.state.position == 5.0
    assert here.state.jumps == 1
    assert here.alignment is Localised.ODOMETRY_WORLD


@pytest.mark.parametrize("mission", [PAIR, *slow(SIX_FROM_START)], ids=["pair", "six"])
def test_robots_with_odometry_from_start_come_into_formation(mission: Mission) -> None:
    fleet = Fleet(mission).after(20.0)
    assert fleet.error() < 0.02
    assert all(agent.here.state.jumps == 0 for agent in fleet.agents.values())


@pytest.mark.parametrize("heading", ["observer", *slow("measured")])
def test_robot_stops_on_odometry_reset_and_resumes_without_lurch(heading: str) -> None:
    fleet = Fleet(with_robots("turtlebot3_pair", odometry_frame="start", heading=heading)).after(20.0)
    reset_odometry(fleet.world.plant("robot1"))
    reset = fleet.now
    fleet.run(0.1)
    status = fleet.status("robot1")
    assert fleet.last_command("robot1") == AT_REST
    assert "odometry jumped" in str(status.reason)
    assert status.jumps == 1
    assert (status.localisation, status.realigned) == (Localised.ODOMETRY_START, 1)
    fleet.run(0.3)
    assert fleet.status("robot1").state == "run"
    fleet.run(10.0)
    after = fleet.commands_since("robot1", reset)
    assert max(abs(speed) for speed, _ in after) <= 0.12  # the robot catches up with its slot
    assert max(abs(turn_rate) for _, turn_rate in after) <= 0.5
    assert fleet.error() < 0.03


def test_odometry_reset_interrupts_published_positions() -> None:
    fleet = Fleet(SIX_FROM_START)
    received: list[float] = []

    def listen(sample: Sample) -> tuple[Sample]:
        received.append(sample.arrived)
        return (sample,)

    fleet.meddle = on(POSITION.key("robot3"), listen)
    fleet.run(5.0)
    reset_odometry(fleet.world.plant("robot3"))
    fleet.run(1.0)
    gaps = sorted(after - before for before, after in itertools.pairwise(received))
    assert 0.15 < gaps[-1] < 0.35
    assert gaps[-2] < 0.1
    fleet.run(5.0)
    assert fleet.error() < 0.05


@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3)])
def test_lossy_odometry_while_turning_is_no_jump(seed: int) -> None:
    dice, fleet = random.Random(seed), Fleet(with_robots("turtlebot3_pair", odometry_frame="start"))
    fleet.meddle = on(ODOM.key("robot1"), lambda one: () if dice.random() < 0.6 else (one,))
    fleet.run(12.0)
    assert fleet.agents["robot1"].here.state.jumps == 0
    fleet.meddle = lambda sample: (sample,)
    fleet.run(8.0)
    assert fleet.error() < 0.03


@pytest.mark.parametrize("far", [1e6, -1e6])
def test_absurd_odometry_moves_no_robot(far: float) -> None:
    fleet = Fleet(with_robots("turtlebot3_pair", odometry_frame="start"))
    fleet.meddle = altered(ODOM.key("robot1"), Odometry, lambda seen: replace(seen, position=far * (1 + 1j)))
    fleet.run(3.0)
    assert set(fleet.commands_since("robot1", 0.0)) == {AT_REST}
    assert fleet.status("robot1").reason.code is Code.POSITION_TOO_FAR


class Driver:
    """Feeds a robot's localisation with odometry, by default straight along x."""

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
        return self.here.update_pose(message, self.mono, at(self.mono))


def driving(law: str = "field") -> Driver:
    driver = Driver(law)
    for _ in range(40):
        driver.drive()
    return driver


@pytest.fixture
def driver() -> Driver:
    driver = driving()
    assert driver.here.state.follows
    assert abs(driver.here.heading - 1.0) < 0.01
    return driver


def test_first_interval_ends_with_second_message() -> None:
    driver = Driver()
    assert driver.drive() is None
    assert not driver.here.state.follows
    assert driver.drive() == pytest.approx(PERIOD, abs=1e-6)
    assert driver.here.state.follows


@pytest.mark.parametrize("gap", [0.2, 0.9, 1.1])
def test_heading_after_gap_needs_a_complete_interval(driver: Driver, gap: float) -> None:
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


def test_gyroscope_reset_is_jump_and_keeps_estimated_heading(driver: Driver) -> None:
    before = driver.here.heading
    assert driver.drive(turn=math.pi / 2.0, move=0.025 - 0.025j) is None
    assert str(driver.here.state.jumped) == "odometry jumped by +1.57 rad"
    assert driver.here.heading == before


@pytest.mark.parametrize("law", LAWS)
def test_impossible_speed_does_not_change_estimated_heading(law: str) -> None:
    driver = driving(law)
    before = driver.here.heading
    assert driver.drive(speed=-1e3, move=1e3 * PERIOD + 0.025) is None
    assert driver.here.state.jumped is not None
    assert driver.here.heading == before


def test_paper_observer_stays_finite_while_reversing() -> None:
    driver = Driver("paper")
    for _ in range(4000):
        driver.drive(speed=-1.5)
        assert cmath.isfinite(driver.here.state.estimate)
    assert abs(driver.here.heading) == pytest.approx(1.0)


def test_course_is_unknown_while_wheels_are_blocked() -> None:
    mission = team({"robot1": ("leader",)}, localisation="external")
    here, noise = Localisation(mission, "robot1", LAWS["field"]), random.Random(1)
    faces, position, moment = cmath.rect(1.0, 2.5), 0j, 0.0
    for phase, speed in enumerate((0.0, 0.5, 0.0)):  # blocked at first and in the end
        for _ in range(40):
            moment += PERIOD
            position += speed * PERIOD * faces
            seen = position + complex(noise.gauss(0.0, 1e-3), noise.gauss(0.0, 1e-3))
            here.update_pose(Pose(EPOCH + moment, seen, 1.0 + 0.0j), moment, at(moment))
            here.commanded(moment, Command(0.5, 0.0))
            assert phase == 0 or abs(cmath.phase(here.course / faces)) <= here.course_doubt
        assert (here.course_doubt < 0.2) if speed else (here.course_doubt == math.pi)
