"""The lower bound of the settling time: nothing beats it, and it equals values computed by hand."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from formation.control.unicycle import advance, control_point
from formation.mission.model import Mission
from formation.simulation.ensemble import Starts
from tests.campaigns.bench import control_trials, lower_bound
from tests.campaigns.bench.control_trials import FIELD, SEED, STIFF, Contender
from tests.campaigns.bench.table import converged_cells
from tests.unit.formation import scenarios

OFFSET, TOP, TURN, SETTLED = 0.2, 1.5, 1.5, 0.05
FAR = 3.0
ROUND = 0.05
"""What rounding down to whole steps and cells may take off [s]."""


def behind_a_leader_at_rest(slot: complex) -> Mission:
    robot = {"control_point_offset": OFFSET, "max_speed": TOP, "max_turn_rate": TURN}
    return scenarios.build(
        np.array([0.0, slot]), ((), (0,)), {"speed": 0.0, "heading_deg": 0.0}, robot=robot, settled=SETTLED
    )


def start(heading: complex) -> Starts:
    return Starts(np.array([[0j]]), np.array([[heading]]))


@pytest.mark.slow
@pytest.mark.parametrize("contender", [FIELD, STIFF], ids=lambda one: one.name)
def test_laws_settle_no_earlier_than_the_bound(contender: Contender) -> None:
    mission = control_trials.six_robots()
    starts = control_trials.drawn(mission, 30, SEED)
    settled = contender.drive(mission, 30, 60.0).settling_time
    assert np.isfinite(settled).mean() > (0.9 if contender is STIFF else 0.999)
    settled = np.where(np.isfinite(settled), settled, np.inf)
    assert (settled >= lower_bound.by_distance(mission, starts)).all()
    assert (settled >= lower_bound.by_body(mission, starts)).all()


def test_bound_of_facing_robot_is_distance_at_top_speed() -> None:
    soonest = lower_bound.by_body(behind_a_leader_at_rest(FAR), start(1.0 + 0.0j))
    exact = (FAR - OFFSET - SETTLED) / TOP
    assert exact - ROUND <= soonest[0] <= exact


def test_bound_of_sideways_robot_includes_turning_while_driving() -> None:
    soonest = lower_bound.by_body(behind_a_leader_at_rest(FAR), start(1j))
    on_the_spot = math.pi / 2.0 / TURN + (FAR - OFFSET - SETTLED) / TOP
    gained_meanwhile = 1.0 / TURN  # [s]; at most gained by driving while it turns
    assert on_the_spot - gained_meanwhile - ROUND <= soonest[0] < on_the_spot


def test_bound_by_distance_uses_top_speed_of_control_point() -> None:
    soonest = lower_bound.by_distance(behind_a_leader_at_rest(FAR), start(1j))
    exact = (abs(FAR - OFFSET * 1j) - SETTLED) / math.hypot(TOP, OFFSET * TURN)
    assert exact - 0.02 <= soonest[0] <= exact


def test_bound_by_body_never_exceeds_time_of_a_drive() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        heading = cmath.exp(1j * rng.uniform(-math.pi, math.pi))
        position, facing, took = 0j, heading, 0.0
        for duration in rng.uniform(0.1, 1.5, 3):
            speed, turn = TOP * rng.choice([-1.0, 1.0]), TURN * rng.choice([-1.0, 0.0, 1.0])
            position, facing = advance(position, facing, speed, turn, duration)
            took += duration
        mission = behind_a_leader_at_rest(complex(control_point(position, facing, OFFSET)))
        assert lower_bound.by_body(mission, start(heading))[0] <= took


@pytest.mark.parametrize(
    ("share", "cells"),
    [(0.0, "0 % | –"), (0.0025, "under 1 % | –"), (0.37, "37 % | 2.0 / 3.0 s"), (1.0, "100 % | 2.0 / 3.0 s")],
)
def test_readings_give_no_times_of_under_one_percent(share: float, cells: str) -> None:
    found = {"converged_fraction": share, "settling_time": {"median": 2.0, "p95": 3.0}}
    assert converged_cells(found) == cells
