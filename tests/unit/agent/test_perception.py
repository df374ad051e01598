"""A robot's pose by scans that take time, while it turns (`formation.agent.perception.perception`)."""

from __future__ import annotations

import cmath
import math

import pytest

from formation.agent.following.neighbours import Neighbour
from formation.agent.perception.perception import Perception
from formation.agent.pose.estimator import Localisation
from formation.agent.safety.scanner import Scanner
from formation.control.unicycle import Command, advance
from formation.mission.model import Mission
from formation.protocol.status import Sight
from formation.ros2.messages import LaserScan, Odometry, Pose
from formation.sensing.raycast import cast
from tests.support.fleet import at
from tests.support.seeing import TRIANGLE, hexagon

PERIOD, TURN_TIME, BEAMS = 0.05, 0.2, 360


def swept(sweep: float | None) -> Mission:
    """Three robots; robot7's scanner needs `sweep` [s] for a turn, as the mission says."""
    mission = hexagon(robots=TRIANGLE)
    spec = mission.robots["robot7"]
    scan = spec.scan.model_copy(update={"sweep": sweep})
    return mission.changed(robots={**mission.robots, "robot7": spec.model_copy(update={"scan": scan})})


class Turning:
    """One robot that drives a circle among two that stand, and what its agent would learn."""

    def __init__(self, mission: Mission, *, against: bool, off: complex, turned: float) -> None:
        """Its scans begin with the newest beam if `against`; it is `off` [m] its start pose, and `turned`."""
        self.here = Localisation(mission, "robot7", mission.law.controller)
        self.scanner, self.perception = Scanner(mission, "robot7"), Perception(mission, "robot7")
        self.others = [Neighbour(mission, name, 20.0) for name in ("robot2", "robot3")]
        self.moving = Command(0.05, 1.2)
        self._mission, self._against = mission, against
        start = mission.robots["robot7"].start
        self._from = start.position + off, start.heading * cmath.rect(1.0, turned)
        towers = [mission.robots[one.name] for one in self.others]
        self._discs = [(one.start.position + one.seen.at * one.start.heading, 0.035) for one in towers]

    def pose(self, time: float) -> tuple[complex, complex]:
        """True centre [m] and heading."""
        return advance(*self._from, *self.moving, time)

    def scan(self, ended: float) -> LaserScan:
        """The scan with its newest beam at that moment [s]."""
        ranges = []
        mount = self._mission.robots["robot7"].scan.mount
        for number in range(BEAMS):
            share = number / (BEAMS - 1)
            position, heading = self.pose(ended - TURN_TIME * (share if self._against else 1.0 - share))
            eye = position + heading * mount.at
            ranges.append(cast(eye, heading * mount.heading, self._discs, (), BEAMS)[number])
        return LaserScan(
            at(ended - TURN_TIME).wall, 0.0, math.tau / BEAMS, 0.12, 3.5, tuple(ranges), scan_time=TURN_TIME
        )

    def tick(self, number: int) -> None:
        """Run one period."""
        time = PERIOD * number
        now, (position, heading) = at(time), advance(0j, 1.0 + 0.0j, *self.moving, time)
        for one in self.others:
            start = self._mission.robots[one.name].start
            one.take_position(Pose(now.wall, start.position, start.heading), time, now)
        if number % 4 == 0 and number:
            scan = self.scan(time)
            self.scanner.process_scan(scan, time, now)
            self.perception.take_scan(scan, self.scanner)
        self.here.update_pose(Odometry(now.wall, position, heading, *self.moving, frame="odom"), time, now)
        self.perception.moved(time, self.here)
        self.scanner.moved(time, self.moving)
        self.perception.step(self.here, self.others, now)


def errors(turning: Turning, ticks: int) -> tuple[float, float]:
    """Error of position [m] and heading [rad] after so many periods."""
    for number in range(ticks):
        turning.tick(number)
    estimate = turning.perception.state.estimate
    assert estimate is not None
    position, heading = turning.pose(PERIOD * (ticks - 1))
    return abs(estimate.position - position), abs(cmath.phase(estimate.heading / heading))


@pytest.mark.parametrize("against", [False, True])
def test_motion_during_the_sweep_is_undone(against: bool) -> None:
    mission = swept(-TURN_TIME if against else TURN_TIME)
    turning = Turning(mission, against=against, off=0.03 - 0.02j, turned=0.03)
    position, heading = errors(turning, 80)
    assert position < 0.015
    assert heading < 0.01
    assert turning.perception.sight(at(80 * PERIOD)) is Sight.LOCKED


def test_sweep_of_the_wrong_direction_is_noticed() -> None:
    """So the test above would fail if motion were not undone."""
    turning = Turning(swept(TURN_TIME), against=True, off=0.03 - 0.02j, turned=0.03)
    position, heading = errors(turning, 80)
    assert max(position, heading) > 0.03


def test_gap_in_odometry_begins_anew() -> None:
    turning = Turning(swept(TURN_TIME), against=False, off=0j, turned=0.0)
    errors(turning, 60)
    state = turning.perception.state
    assert turning.perception.sight(at(60 * PERIOD)) is Sight.LOCKED
    turning.here.state.since_last = None  # as after a jump
    turning.perception.moved(60 * PERIOD, turning.here)
    assert turning.perception.sight(at(60 * PERIOD)) is Sight.SEARCHING
    assert state.estimate is not None
    assert state.estimate.position == turning.here.state.position
    assert turning.perception.doubt(at(60 * PERIOD)) is not None
