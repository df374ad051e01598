"""Scans as the drivers of known scanners send them, and what agents make of them."""

from __future__ import annotations

import cmath
import math
import statistics

import pytest

from formation.agent.safety.scanner import Scanner
from formation.mission.model import Mission
from formation.protocol.status import Sight
from formation.ros2.messages import LaserScan, decode, encode
from formation.sensing.detection import Detection, beams, detection
from formation.sensing.models import MODELS
from tests.campaigns.perception.towers import errors as errors_of_towers
from tests.support.drivers import BACKGROUND, DRIVERS, SAMPLES, TOWER, directions, distance_along, sent
from tests.support.examples import slow
from tests.support.fleet import at
from tests.support.seeing import TRIANGLE, fleet_of, hexagon, shape_error
from tests.unit.agent.test_perception import PERIOD, Turning, errors


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
def test_lost_beams_are_lost_and_nothing_else(model: str) -> None:
    scan = sent(model, [], 0)
    nothing = [one for one in scan.ranges if not scan.range_min <= one <= scan.range_max]
    assert 0 < len(nothing) < 0.4 * len(scan.ranges)
    assert min(segment.distance for segment in beams(scan, MODELS[model].noise).segments) > 0.9 * BACKGROUND


def test_limits_are_those_of_the_data_sheet() -> None:
    limits = {model: sent(model, [], 0) for model in MODELS}
    assert {model: (scan.range_min, scan.range_max) for model, scan in limits.items()} == {
        "lds_01": (pytest.approx(0.12), 3.5),
        "lds_02": (0.16, 8.0),
        "rplidar_a1": (0.15, 12.0),
    }


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


def test_range_of_zero_is_a_lost_beam() -> None:
    scan = sent("lds_01", [(1.0 + 0.0j, TOWER)], 3)
    open_limits = LaserScan(0.0, 0.0, scan.angle_increment, 0.0, 100.0, scan.ranges)
    assert beams(open_limits).segments == beams(scan).segments


class Driven(Turning):
    """The robot of `Turning`; its scanner has a known model, and its scans come as that driver sends them."""

    def __init__(self, model: str, mission: Mission) -> None:
        super().__init__(mission, against=True, off=0.03 - 0.02j, turned=0.03)
        self._model = model

    def scan(self, ended: float) -> LaserScan:
        """The scan of the turn that ended at that moment [s], as the agent uses it."""
        turn_time, readings = MODELS[self._model].turn_time, []
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
    """Three robots with scanners of one model, and what the mission says of their sweep."""
    return hexagon(robots=TRIANGLE, scan=f'model = "{model}"{sweep}')


@pytest.mark.parametrize("model", MODELS)
def test_robot_locks_by_scans_of_every_driver_while_it_turns(model: str) -> None:
    turning = Driven(model, with_model(model))
    position, heading = errors(turning, 100)
    assert position < 0.02
    assert heading < 0.015
    assert turning.perception.sight(at(100 * PERIOD)) is Sight.LOCKED


@pytest.mark.parametrize("model", ["lds_02", "rplidar_a1"])
def test_direction_of_the_sweep_matters(model: str) -> None:
    """So the test above would fail if the model did not say that the first beam is the newest."""
    turning = Driven(model, with_model(model, f", sweep = {MODELS[model].turn_time}"))
    assert max(errors(turning, 100)) > 0.03


def test_sweep_follows_from_model_or_scan() -> None:
    scan = sent("lds_02", [], 0, count=230)
    sweeps = {model: Scanner(with_model(model), "robot7").sweep(scan) for model in MODELS}
    assert sweeps["lds_01"] == -0.2
    assert sweeps["lds_02"] == sweeps["rplidar_a1"] == pytest.approx(-0.1, abs=0.002)
    assert Scanner(hexagon(robots=TRIANGLE), "robot7").sweep(scan) > 0.0


@pytest.mark.parametrize("model", ["lds_01", *slow("lds_02", "rplidar_a1")])
def test_rehearsed_robots_with_known_scanners_keep_their_shape(model: str) -> None:
    fleet = fleet_of(with_model(model)).after(12.0)
    assert {fleet.status(robot).sight for robot in ("robot3", "robot7")} == {Sight.LOCKED}
    assert max(shape_error(one) for one in fleet.every(1.0, 5.0)) < 0.03
