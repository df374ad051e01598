"""Pose of a robot by its range scans: the filter, swept scans, scans as known drivers send them."""

from __future__ import annotations

import cmath
import math
import statistics
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.neighbour import Neighbour
from formation.agent.perception.perception import Perception
from formation.agent.perception.pose_filter import (
    Estimate,
    Measurement,
    doubted,
    first,
    moved,
    sightline,
    squared_distance,
    updated,
    widened,
)
from formation.agent.pose.estimator import Localisation
from formation.agent.safety.scanner import Scanner
from formation.control.unicycle import Command, advance, along
from formation.mission.model import Mission
from formation.protocol.status import Sight
from formation.ros2.messages import LaserScan, Odometry, Pose, decode, encode
from formation.sensing.detection import Detection, beams, detection
from formation.sensing.models import MODELS
from formation.sensing.raycast import cast
from tests.campaigns.perception.towers import errors as errors_of_towers
from tests.support.drivers import BACKGROUND, DRIVERS, SAMPLES, TOWER, directions, distance_along, sent
from tests.support.fleet import at
from tests.support.seeing import TRIANGLE, fleet_of, hexagon, shape_error

PERIOD, TURN_TIME, BEAMS = 0.05, 0.2, 360


def swept(sweep: float | None) -> Mission:
    """Three robots; robot7's scanner needs `sweep` [s] for a turn, as in the mission."""
    mission = hexagon(robots=TRIANGLE)
    spec = mission.robots["robot7"]
    scan = spec.scan.model_copy(update={"sweep": sweep})
    return mission.changed(robots={**mission.robots, "robot7": spec.model_copy(update={"scan": scan})})


class Turning:
    """One robot that drives a circle among two that stand, and its agent's perception."""

    def __init__(self, mission: Mission, *, against: bool, off: complex, turned: float) -> None:
        """Scans begin with the newest beam if `against`; the robot is `off` [m] its start, and `turned`."""
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
def test_motion_during_sweep_is_compensated(against: bool) -> None:
    mission = swept(-TURN_TIME if against else TURN_TIME)
    turning = Turning(mission, against=against, off=0.03 - 0.02j, turned=0.03)
    position, heading = errors(turning, 80)
    assert position < 0.015
    assert heading < 0.01
    assert turning.perception.sight(at(80 * PERIOD)) is Sight.LOCKED


def test_gap_in_odometry_restarts_estimate() -> None:
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


def found(scan: LaserScan, model: str) -> list[Detection]:
    """Every cylinder of a tower's radius."""
    divided = beams(scan, MODELS[model].noise)
    every = [detection(one, divided, TOWER) for one in divided.segments]
    return [one for one in every if one is not None and one.whole]


@pytest.mark.parametrize("wall", [BACKGROUND, math.inf])
@pytest.mark.parametrize("model", MODELS)
def test_tower_is_found_in_scans_of_every_driver(model: str, wall: float) -> None:
    off = errors_of_towers(model, wall=wall, scans=200)
    assert len(off.distances) > 0.9 * 200
    assert abs(statistics.mean(off.distances)) < 5e-3
    assert abs(statistics.mean(off.directions)) < math.radians(0.3)
    assert 0.3 < statistics.mean(off.squares) < 1.6


@pytest.mark.parametrize("model", MODELS)
def test_lost_beams_form_no_segment(model: str) -> None:
    scan = sent(model, [], 0)
    lost = [one for one in scan.ranges if not scan.range_min <= one <= scan.range_max]
    assert 0 < len(lost) < 0.4 * len(scan.ranges)
    assert min(segment.distance for segment in beams(scan, MODELS[model].noise).segments) > 0.9 * BACKGROUND


def test_scan_of_too_fine_beams_is_not_completed() -> None:
    fine = LaserScan(0.0, 0.0, 1e-4, 0.12, 3.5, (1.0,) * 100)
    assert all(len(model.corrected(fine).ranges) == 100 for model in MODELS.values())
    coarse = LaserScan(0.0, 0.0, math.tau / 360, 0.12, 3.5, (1.0,) * 100)
    assert all(len(model.corrected(coarse).ranges) == 360 for model in MODELS.values())


def test_faster_lds_02_has_fewer_beams() -> None:
    centre = cmath.rect(0.8, 0.5)
    scans = [sent("lds_02", [(centre, TOWER)], seed, count=230) for seed in range(50)]
    assert all(226 <= len(scan.ranges) <= 234 and 0.098 < scan.scan_time < 0.102 for scan in scans)
    near = [one for scan in scans for one in found(scan, "lds_02") if abs(one.angle - 0.5) < 0.1]
    assert len(near) > 0.9 * 50


def test_range_of_zero_counts_as_lost_beam() -> None:
    scan = sent("lds_01", [(1.0 + 0.0j, TOWER)], 3)
    open_limits = LaserScan(0.0, 0.0, scan.angle_increment, 0.0, 100.0, scan.ranges)
    assert beams(open_limits).segments == beams(scan).segments


class Driven(Turning):
    """The robot of `Turning` with scans as the driver of a known scanner model sends them."""

    def __init__(self, model: str, mission: Mission) -> None:
        super().__init__(mission, against=True, off=0.03 - 0.02j, turned=0.03)
        self._model = model

    def scan(self, ended: float) -> LaserScan:
        """The scan of the turn that ended at that moment [s], as the agent uses it."""
        turn_time, readings = 1.0 / MODELS[self._model].rate, []
        mount, along = (
            self._mission.robots["robot7"].scan.mount,
            directions(self._model, SAMPLES[self._model]),
        )
        for number, direction in enumerate(along):
            position, heading = self.pose(ended - turn_time * (1.0 - (number + 1) / len(along)))
            eye, axis = position + heading * mount.at, heading * mount.heading
            discs = [((centre - eye) / axis, radius) for centre, radius in self._discs]
            readings.append(distance_along(direction, discs, math.inf))
        scan = DRIVERS[self._model](readings, at(ended).wall, turn_time, 1.0)
        return self.scanner.corrected(decode(LaserScan, encode(scan)))


def with_model(model: str, sweep: str = "") -> Mission:
    """Three robots with scanners of one model; `sweep` are more keys of `scan`."""
    return hexagon(robots=TRIANGLE, scan=f'model = "{model}"{sweep}')


@pytest.mark.parametrize("model", MODELS)
def test_turning_robot_locks_with_scans_of_every_driver(model: str) -> None:
    turning = Driven(model, with_model(model))
    position, heading = errors(turning, 100)
    assert position < 0.02
    assert heading < 0.015
    assert turning.perception.sight(at(100 * PERIOD)) is Sight.LOCKED


def test_sweep_follows_from_model_or_scan() -> None:
    scan = sent("lds_02", [], 0, count=230)
    sweeps = {model: Scanner(with_model(model), "robot7").sweep(scan) for model in MODELS}
    assert sweeps["lds_01"] == -0.2
    assert sweeps["lds_02"] == sweeps["rplidar_a1"] == pytest.approx(-0.1, abs=0.002)
    assert Scanner(hexagon(robots=TRIANGLE), "robot7").sweep(scan) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("model", ["lds_01", "lds_02", "rplidar_a1"])
def test_simulated_robots_with_known_scanners_keep_shape(model: str) -> None:
    fleet = fleet_of(with_model(model)).after(12.0)
    assert {fleet.status(robot).sight for robot in ("robot3", "robot7")} == {Sight.LOCKED}
    assert max(shape_error(one) for one in fleet.every(1.0, 5.0)) < 0.03


SCANNER = -0.032 + 0.01j
EXACT = (1e-6, 1e-6)
"""Variances of a scanner without noise [m²; rad²]."""
angles = st.floats(-math.pi, math.pi)
offsets = st.complex_numbers(max_magnitude=0.08)
turns = st.floats(-0.08, 0.08)


def seen_from(position: complex, heading: complex, centre: complex) -> complex:
    """A centre as an exact scanner measures it [m; body frame]."""
    return (centre - position) / heading - SCANNER


def corrected(estimate: Estimate, seen: Sequence[tuple[complex, complex]]) -> Estimate:
    """The estimate after both measurements of each robot: centre [m; team's frame] and its ray."""
    for centre, ray in seen:
        for which in (0, 1):
            measurement = sightline(estimate, centre, SCANNER, ray, EXACT)[which]
            estimate = updated(estimate, measurement) or estimate
    return estimate


@given(offsets, angles, turns, angles, st.floats(0.6, 2.5), st.floats(0.5, 2.6))
def test_exact_measurements_of_two_neighbours_give_the_pose(
    off: complex, facing: float, turned: float, bearing: float, distance: float, apart: float
) -> None:
    position, heading = 1.0 + 2.0j, cmath.rect(1.0, facing)
    centres = [position + cmath.rect(distance, one) for one in (bearing, bearing + apart)]
    rays = [seen_from(position, heading, one) for one in centres]
    estimate = first(position + off, heading * cmath.rect(1.0, turned), 0.05, math.radians(3.0))
    for _ in range(10):
        estimate = widened(
            corrected(estimate, list(zip(centres, rays, strict=True))), 0.01, math.radians(0.5)
        )
    assert abs(estimate.position - position) < 1e-3
    assert abs(estimate.heading - heading) < 1e-3


@given(turns, st.floats(-0.6, 0.6))
def test_heading_follows_from_motion_and_one_neighbour(turned: float, turn: float) -> None:
    position, heading, centre = 0j, 1.0 + 0.0j, 1.0 + 0.6j
    estimate = first(position, cmath.rect(1.0, turned), 0.05, math.radians(3.0))
    for _ in range(60):
        motion, _ = along(0j, 1.0 + 0.0j, 0.03, 0.05 * turn)
        position, heading = position + heading * motion, heading * cmath.rect(1.0, 0.05 * turn)
        centre += 0.03
        estimate = moved(estimate, motion, 0.05 * turn, 0.2)
        estimate = corrected(estimate, [(centre, seen_from(position, heading, centre))])
    # motion has shown the rotation about the neighbour, which one measurement leaves open
    assert abs(estimate.heading - heading) < max(2e-3, 0.3 * abs(turned))


def test_rotation_stays_uncertain_with_one_standing_neighbour() -> None:
    estimate = first(0j, 1.0 + 0.0j, 0.05, math.radians(3.0))
    for _ in range(100):
        estimate = corrected(estimate, [(1.0 + 0.0j, seen_from(0j, 1.0 + 0.0j, 1.0 + 0.0j))])
    assert deviations(estimate)[1] > math.radians(1.0)
    assert math.sqrt(estimate.covariance[0][0]) < 0.01


def deviations(estimate: Estimate) -> tuple[float, float]:
    """Of the position in its worst direction [m], and of the heading [rad]."""
    covariance = np.array(estimate.covariance)
    return math.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]), math.sqrt(covariance[2, 2])


@given(st.floats(0.0, 0.5), angles, st.floats(0.0, 1.0))
def test_motion_without_measurement_never_reduces_deviation(way: float, turn: float, elapsed: float) -> None:
    before = first(1j, 1j, 0.02, 0.01)
    after = moved(before, complex(way), turn, elapsed)
    for larger, smaller in zip(deviations(after), deviations(before), strict=True):
        assert larger >= smaller
    assert after.position == pytest.approx(1j + 1j * way)


@given(angles, st.complex_numbers(min_magnitude=0.3, max_magnitude=3.0), st.floats(0.5, 2.0))
def test_jacobian_equals_numerical_derivative(facing: float, away: complex, distance: float) -> None:
    estimate = first(0.3 - 0.2j, cmath.rect(1.0, facing), 0.05, 0.05)
    centre = estimate.position + away * distance / abs(away)
    ray = cmath.rect(1.0, 0.1)
    at = sightline(estimate, centre, SCANNER, ray, EXACT)
    step = 1e-6
    for column, other in enumerate(
        (
            estimate._replace(position=estimate.position + step),
            estimate._replace(position=estimate.position + step * 1j),
            estimate._replace(heading=estimate.heading * cmath.rect(1.0, step)),
        )
    ):
        for before, after in zip(at, sightline(other, centre, SCANNER, ray, EXACT), strict=True):
            change = math.remainder(before.innovation - after.innovation, math.tau)
            assert change / step == pytest.approx(before.jacobian[column], abs=1e-4)


def test_improbable_measurement_is_not_used() -> None:
    estimate = first(0j, 1.0 + 0.0j, 0.01, 0.01)
    assert updated(estimate, Measurement(0.1, (-1.0, 0.0, 0.0, 0.0), 1e-4)) is None
    assert updated(estimate, Measurement(0.03, (-1.0, 0.0, 0.0, 0.0), 1e-4)) is not None
    assert updated(estimate, Measurement(math.nan, (-1.0, 0.0, 0.0, 0.0), 1e-4)) is None


def test_doubted_sets_deviations_without_correlation() -> None:
    estimate = doubted(moved(first(0j, 1j, 1e-3, 1e-3), 0.1 + 0j, 0.0, 0.2), 0.05, 0.02)
    assert deviations(estimate) == pytest.approx((0.05, 0.02))
    assert estimate.covariance[0][2] == 0.0


def test_squared_distance_of_independent_measurements() -> None:
    estimate = first(0j, 1.0 + 0.0j, 0.0, 0.0)
    one = Measurement(0.3, (-1.0, 0.0, 0.0, 0.0), 0.01)
    other = Measurement(0.2, (0.0, 1.0, 0.0, 0.0), 0.04)
    assert squared_distance(estimate, one, other) == pytest.approx(9.0 + 1.0)
