"""Odometry stamped on publication: its stamps are fresh, what it measured is old."""

from __future__ import annotations

import pytest

from formation.agent.simulated.faults import Fault
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from tests.support.fleet import Fleet
from tests.support.sensing import faulty, mission_of, noisy, watch

BOUND = 0.1
"""So far a robot may drive from 3 s after the start on [m]."""


@pytest.mark.parametrize("late", [0.4, 0.6, 1.0])
def test_late_odometry_with_fresh_stamps_holds_the_robot(late: float) -> None:
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "restamped", late, 0.0))
    fleet.run(3.0)
    before = fleet.plant("robot3").path
    decision = fleet.agents["robot3"].decision
    assert decision.reason.code is Code.MOTION_LATE
    assert decision.reason.values["seen"] == pytest.approx(late, abs=0.06)
    fleet.run(17.0)
    assert fleet.plant("robot3").path - before < BOUND


@pytest.mark.slow
def test_robot_goes_on_when_odometry_is_prompt_again() -> None:
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "restamped", 0.4, 0.0, 6.0))
    fleet.run(30.0)
    assert fleet.agents["robot3"].decision.state is AgentState.RUN
    assert fleet.error() < 0.05


@pytest.mark.slow
def test_delay_within_limit_with_noise_causes_no_hold() -> None:
    mission = noisy(mission_of("six_robots", "odometry"), 0.005)
    assert watch(faulty(mission, Fault("robot2", "restamped", 0.3, 0.0)), 20.0).holds == {}


def test_stuttering_fault_drives_no_further_than_frozen() -> None:
    fleet: Fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "stutter", 0.35, 8.0))
    fleet.run(9.5)
    before = fleet.plant("robot3").path
    fleet.run(8.0)
    assert fleet.plant("robot3").path - before < BOUND
