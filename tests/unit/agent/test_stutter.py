"""Sensors that come and go while they lie: evidence and probes survive the gaps."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from formation.agent.simulated.faults import Fault
from formation.protocol.reasons import Code
from formation.topics import ODOM
from formation.wire import Sample
from tests.support.fleet import Fleet
from tests.support.sensing import faulty, mission_of

BEGIN = 8.0
"""The fault begins so long after the start [s]."""
BOUND = 0.1
"""So far a robot may drive from 1 s after the fault on [m]."""


def bursts(fleet: Fleet, robot: str, burst: float, gap: float) -> Callable[[Sample], tuple[Sample, ...]]:
    """Lose the robot's odometry for `gap` after each `burst` [s]."""

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        if sample.key == ODOM.key(robot) and fleet.now > BEGIN and fleet.now % (burst + gap) > burst:
            return ()
        return (sample,)

    return meddle


def stuttering(burst: float, gap: float) -> Fleet:
    """A fleet in which the odometry of robot3 freezes and comes in bursts."""
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "frozen", 0.0, BEGIN))
    fleet.meddle = bursts(fleet, "robot3", burst, gap)
    return fleet


@pytest.mark.parametrize(("burst", "gap"), [(0.35, 0.6), (0.2, 0.2)])
def test_frozen_odometry_in_bursts_holds_the_robot(burst: float, gap: float) -> None:
    fleet = stuttering(burst, gap)
    fleet.run(BEGIN + 1.5)
    before = fleet.plant("robot3").path
    fleet.run(10.0)
    assert fleet.plant("robot3").path - before < BOUND
    assert fleet.agents["robot3"].motion.state.doubt is not None


def test_interrupted_probes_stay_bounded() -> None:
    fleet = stuttering(1.45, 0.2)
    fleet.run(BEGIN + 1.5)
    before = fleet.plant("robot3").path
    fleet.run(30.0)
    assert fleet.plant("robot3").path - before < BOUND
    assert fleet.agents["robot3"]._probe.state.tries > 2


def test_odometry_that_comes_in_bursts_causes_no_doubt() -> None:
    fleet = Fleet(mission_of("six_robots", "odometry"))
    fleet.meddle = bursts(fleet, "robot3", 0.5, 0.3)
    while fleet.now < BEGIN + 15.0:
        fleet.run(0.1)
        assert fleet.agents["robot3"].motion.state.doubt is None
    assert fleet.agents["robot3"].decision.reason.code in {
        Code.RUNNING,
        Code.POSITION_SILENT,
        Code.POSITION_GAP,
    }
