"""Closed-loop scenarios of late messages and wrong clocks, which look alike to the receiver."""

from __future__ import annotations

from dataclasses import replace
from statistics import median

import pytest

from formation.mission.file import load
from formation.ros2.messages import Odometry
from formation.topics import ODOM
from tests.support.fleet import Fleet
from tests.support.meddling import altered
from tests.support.missions import with_robots
from tests.unit.agent.sudden import largest_command_change

SIX = load("six_robots")
UNRAMPED = with_robots("six_robots", ramp=0.0)
SPEED = 0.2
"""Speed of the leader [m/s]."""
EDGES = sum(len(robot.neighbours) for robot in SIX.robots.values())


def set_clock(fleet: Fleet, name: str, error: float) -> None:
    """Set the clock error of a robot's computer [s], which stamps its odometry as well."""
    fleet.nodes[name].clock_error = error
    fleet.meddle = altered(ODOM.key(name), Odometry, lambda seen: replace(seen, stamp=seen.stamp + error))


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.1, 0.3, 0.49])
def test_delay_compensation_keeps_formation_with_late_positions(delay: float) -> None:
    fleet = Fleet(SIX, delay=(delay, delay + 0.001)).after(20.0)
    assert fleet.error() < 0.02


@pytest.mark.slow
def test_delay_without_compensation_leaves_formation_error() -> None:
    mission = SIX.model_copy(update={"law": SIX.law.model_copy(update={"delay_compensation": False})})
    fleet = Fleet(mission, delay=(0.10, 0.101)).after(20.0)
    assert fleet.error() > 0.05


@pytest.mark.slow
def test_delays_around_limit_cause_no_command_jump() -> None:
    """The ramp is on: without it, the gain of 8 1/s turns an age of 0.3 s into 1.6 m/s."""
    fleet = Fleet(SIX, delay=(0.35, 0.65), seed=1).after(12.0)
    assert median(fleet.errors(10.0)) < 0.3 * EDGES * SPEED * 0.5
    assert largest_command_change(fleet, since=12.0) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("error", [-3600.0, -10.0, -0.5, -0.3, -0.1, 0.1, 0.3, 0.5, 0.7, 1.2, 10.0, 3600.0])
def test_formation_error_with_wrong_clock_is_bounded(error: float) -> None:
    fleet = Fleet(SIX)
    set_clock(fleet, "robot3", error)
    fleet.run(15.0)
    plain = abs(error) > 1.0
    assert fleet.error() < (SIX.settled if plain else EDGES * SPEED * abs(error))
    assert fleet.status("robot3").clock or not plain


@pytest.mark.slow
@pytest.mark.parametrize("step", [-3600.0, -10.0, -0.3, 0.3, 0.5, 0.7, 10.0, 3600.0])
def test_clock_step_while_driving_causes_no_command_jump(step: float) -> None:
    fleet = Fleet.under_way(UNRAMPED, 14.0)
    set_clock(fleet, "robot3", step)
    fleet.run(4.0)
    assert largest_command_change(fleet, since=13.9) < 0.5
    fleet.run(6.0)
    assert fleet.error() < SIX.settled or abs(step) < 1.0
