"""`OdometrySource.align` moves the placement of odometry slowly towards a better pose."""

from __future__ import annotations

import cmath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.pose.estimator import Localisation
from formation.agent.pose.sources import MAX_ALIGN_RATE, MAX_ALIGN_SPEED, OdometrySource
from formation.control.laws import LAWS
from formation.mission.file import load
from formation.ros2.messages import Odometry
from tests.support.fleet import at
from tests.support.missions import with_robots

PERIOD = 0.05
START = with_robots("six_robots", odometry_frame="start")


def odometry(position: complex, heading: complex, stamp: float = 0.0) -> Odometry:
    return Odometry(stamp, position, heading, 0.0, 0.0, frame="odom")


def pose(source: OdometrySource, message: Odometry) -> tuple[complex, complex]:
    """Position [m] and heading of a message by the present placement."""
    update = source.make_update(message, PERIOD, 1.0)
    return update.position, update.heading


@given(st.complex_numbers(max_magnitude=1.0), st.floats(-3.0, 3.0), st.complex_numbers(max_magnitude=3.0))
def test_align_reaches_better_pose_within_speed_limits(off: complex, turn: float, counted: complex) -> None:
    source = OdometrySource(START, "robot3")
    message = odometry(counted, cmath.rect(1.0, 0.4))
    position, heading = pose(source, message)
    better, facing = position + off, heading * cmath.rect(1.0, turn)
    for _ in range(3000):
        source.align(better, facing, PERIOD)
        after, turned = pose(source, message)
        assert abs(after - position) <= MAX_ALIGN_SPEED * PERIOD + 1e-9
        assert abs(cmath.phase(turned / heading)) <= MAX_ALIGN_RATE * PERIOD + 1e-9
        position, heading = after, turned
    assert abs(position - better) < 1e-6
    assert abs(cmath.phase(heading / facing)) < 1e-6


def test_correction_is_distance_from_odometry_alone() -> None:
    """Two sources read the same odometry, which restarts at zero on the way; only one is aligned."""
    source, alone = OdometrySource(START, "robot3"), OdometrySource(START, "robot3")
    assert source.correction == 0.0
    for tick in range(200):
        counted = 0.005 * (tick if tick < 120 else tick - 120)
        message = Odometry(tick * PERIOD, complex(counted), 1.0 + 0.0j, 0.1, 0.0, frame="odom")
        position, _ = pose(source, message)
        expected, _ = pose(alone, message)
        assert source.correction == pytest.approx(abs(position - expected), abs=1e-9)
        source.align(position + 0.002j, cmath.rect(1.0, 0.3), PERIOD)
    assert source.state.realigned == alone.state.realigned == 1
    assert source.correction > 0.1


def test_align_before_odometry_changes_nothing() -> None:
    source = OdometrySource(START, "robot3")
    before = source.state.origin, source.state.rotation
    assert source.align(3.0 + 0.0j, 1j, PERIOD) == (0j, 1.0)
    assert (source.state.origin, source.state.rotation) == before


@pytest.mark.parametrize("law", LAWS)
def test_align_turns_observed_heading_and_course(law: str) -> None:
    here = Localisation(load("six_robots"), "robot3", LAWS[law])
    for now in (at(PERIOD * tick) for tick in range(3)):
        here.update_pose(odometry(0j, 1.0 + 0.0j, now.wall), now.mono, now)
    before, course = here.state.estimate, here.state.course
    for _ in range(1000):
        here.align(here.state.position, 1j)
    turned = here.state.estimate / before if before else 1.0
    is_heading = LAWS[law].observer.start is None
    assert turned == pytest.approx(1j if is_heading else 1.0, abs=1e-3)
    assert here.state.course / course == pytest.approx(1j, abs=1e-3)
