"""The yardstick: its laws step by step, figures of given errors, and its page. No simulation."""

from __future__ import annotations

import numpy as np
import pytest

from formation.control.arrays import FloatArray
from formation.control.controller import Gains, Limits, Measured
from formation.control.plane import rotation
from formation.control.unicycle import advance
from tests.campaigns.bench.yardstick_laws import FOLLOWER, PREDICTIVE
from tests.campaigns.bench.yardstick_page import words
from tests.campaigns.bench.yardstick_trials import LAW, SCENARIOS, SETTLED, STEP, STRIDE, figures

LIMITS = Limits(0.2, 1.5, 1.5)


def away_after(gains: Gains, slot: complex, velocity: complex, steps: int, dt: float = 0.1) -> float:
    """Distance of the control point from a slot that moves [m], by the predictive law from the origin."""
    position, heading = 0j, 1.0 + 0j
    for _ in range(steps):
        point = position + LIMITS.offset * heading
        measured = Measured(2.0 * heading.conjugate() * (slot - point), 0j, 2.0, velocity)
        command, _ = PREDICTIVE.step(0j, heading, measured, gains, LIMITS, dt)
        assert abs(command.speed) <= LIMITS.max_speed
        assert abs(command.turn_rate) <= LIMITS.max_turn_rate
        position, heading = advance(position, heading, command.speed, command.turn_rate, dt)
        slot += dt * velocity
    return abs(slot - position - LIMITS.offset * heading)


@pytest.mark.parametrize("slot", [2.0 + 1.0j, -1.0 + 1.0j, -1.5j])
def test_predictive_law_reaches_a_moving_slot(slot: complex) -> None:
    assert away_after(Gains(10.0, 0.003), slot, 0.2 * rotation(0.5), 60) < 0.01


def test_follower_turns_to_the_robot_before_it_and_keeps_distance() -> None:
    gains = Gains(1.0, 2.0)
    ahead, _ = FOLLOWER.step(0j, 1.0 + 0j, Measured(0.7 + 0j, 0.5j, 1.0), gains, LIMITS, 0.02)
    assert ahead.turn_rate == 0.0
    assert ahead.speed == pytest.approx(0.2)
    beside, _ = FOLLOWER.step(0j, 1.0 + 0j, Measured(0.5j, 0.5 + 0j, 1.0), gains, LIMITS, 0.02)
    assert beside.turn_rate == LIMITS.max_turn_rate
    assert beside.speed == pytest.approx(0.0)


def errors(settled_from: int, moments: int = 1500) -> FloatArray:
    """Errors of two edges in one run, under the bound from one moment on, but for one peak of 3 cm."""
    found = np.full((moments, 1, 2), 0.01)
    found[:settled_from] = 1.0
    found[moments - 10, 0, 1] = 0.03
    return found


def test_figures_of_a_run_are_as_defined() -> None:
    one = figures(errors(100), errors(100))
    assert one["median"] == pytest.approx(STEP * STRIDE * 101)
    assert one["share"] == 1.0
    assert one["peak"] == 0.03
    assert 0.01 < one["rms"] < 0.011


def test_run_that_never_stays_settled_has_no_settling_time() -> None:
    swinging = errors(100)
    swinging[::200] = 2.0 * SETTLED
    one = figures(swinging, swinging)
    assert (one["share"], one["median"]) == (0.0, None)
    assert words(one).count("–") == 1


def test_route_of_every_scenario_lasts_to_its_horizon() -> None:
    for one in SCENARIOS.values():
        mission = one.build()
        durations = [getattr(leg, "duration", None) for leg in mission.route]
        assert None in durations or sum(filter(None, durations)) >= one.horizon
        for law in LAW.values():
            assert law.mission(mission, {key: some[0] for key, some in law.tried.items()}).names
