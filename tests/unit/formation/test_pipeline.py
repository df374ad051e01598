"""The control step that agents and simulation share."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given

from formation.control.avoidance import Obstacle, brake
from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.laws import LAWS
from formation.control.pipeline import ControlState, Inputs, at_rest, control_step, law_command
from formation.control.ramp import MAX_CHANGE_SHARE, Ramp
from formation.control.unicycle import AT_REST, Command
from formation.mission.file import load
from formation.simulation.simulate import simulate
from tests.unit.formation import scenarios
from tests.unit.formation.planar import headings, vectors

SIX = load("six_robots")
SPEC = SIX.robots["robot2"]
PERIOD = 1.0 / SPEC.rate
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def inputs(now: float, measured: Measured, heading: complex = 1.0 + 0.0j) -> Inputs:
    return Inputs(now, PERIOD, heading, measured, Gains(2.0, 1.0))


def stepped(before: Command, now: float = 1.0) -> ControlState:
    """The state one period after a command."""
    return ControlState(ramp=Ramp(before, now - PERIOD, -math.inf))


@every_law
@given(vectors, headings)
def test_commands_ramp_where_the_law_says_so(law: Controller, relative: complex, heading: complex) -> None:
    params, measured = SIX.control("robot2", law), Measured(relative, 0j, 1)
    state, outcome = control_step(stepped(AT_REST), inputs(1.0, measured, heading), (), params)
    most = PERIOD / SPEC.ramp if law.ramp else 1.0
    assert abs(outcome.command.speed) <= most * SPEC.max_speed + 1e-9
    assert abs(outcome.command.turn_rate) <= most * SPEC.max_turn_rate + 1e-9
    assert state.ramp.before == outcome.command
    if not law.ramp:
        assert outcome.command == outcome.target


@every_law
def test_obstacles_count_where_the_law_has_a_filter(law: Controller) -> None:
    ahead = Obstacle(0.25 + 0j, 0.1, 0j, first=True)
    goes = Measured(10.0 + 0j, 0j, 1)
    known = (ahead,) if law.collision_filter else ()
    params = SIX.control("robot2", law)
    _, outcome = control_step(stepped(AT_REST), inputs(1.0, goes), known, params)
    assert params.avoids == outcome.filtered == law.collision_filter
    assert (outcome.target.speed < 0.5 * SPEC.max_speed) == law.collision_filter


def test_warn_mode_changes_no_command() -> None:
    warns = SIX.model_copy(update={"collisions": SIX.collisions.model_copy(update={"mode": "warn"})})
    params, ahead = warns.control("robot2", LAWS["field"]), Obstacle(0.25 + 0j, 0.1, 0j, first=True)
    around = inputs(1.0, Measured(10.0 + 0j, 0j, 1))
    state = stepped(Command(SPEC.max_speed, 0.0))
    _, outcome = control_step(state, around, (ahead,), params)
    assert outcome.filtered
    assert outcome.command == law_command(state, around, params)[0]


def test_ramp_never_outruns_the_brake() -> None:
    params, ahead = SIX.control("robot2", LAWS["field"]), Obstacle(0.25 + 0j, 0.1, 0j, first=True)
    goes = inputs(1.0, Measured(10.0 + 0j, 0j, 1))
    _, outcome = control_step(stepped(Command(SPEC.max_speed, 0.0)), goes, (ahead,), params)
    slowest = SPEC.max_speed * (1.0 - PERIOD / SPEC.ramp)
    assert outcome.command == brake(Command(slowest, 0.0), [ahead], params.avoidance)
    assert outcome.target.speed < outcome.command.speed < 0.1 * slowest


@every_law
def test_commands_that_are_not_finite_are_reported(law: Controller) -> None:
    params = SIX.control("robot2", law)
    state, outcome = control_step(stepped(AT_REST), inputs(1.0, Measured(math.nan * 1j, 0j, 1)), (), params)
    assert not outcome.finite
    assert state.ramp == stepped(AT_REST).ramp


def test_rest_forgets_ramp_and_remainder_alone() -> None:
    state = ControlState(1.0 + 2.0j, ramp=Ramp(Command(0.5, 0.1), 0.0, 0.3), remainder=Command(0.004, 0.0))
    assert at_rest(state, 2.0) == state._replace(ramp=Ramp(AT_REST, 2.0, 0.3), remainder=AT_REST)


@pytest.mark.parametrize("step", [0.0, 0.02, 0.05])
def test_simulation_takes_the_robots_own_parameters(step: float) -> None:
    for law in LAWS.values():
        assert SIX.control("robot2", law, step) == SIX.control("robot2", law)


def test_steps_longer_than_the_robots_period_cause_no_gap() -> None:
    params = SIX.control("robot2", LAWS["field"], 0.2)
    assert params.ramp.gap > 0.2
    assert params.avoidance.hold >= 0.2


# In simulation


@every_law
def test_simulated_commands_change_no_faster_than_the_ramp(law: Controller) -> None:
    history = simulate(SIX, law=law, horizon=5.0, step=0.02, keep=True).history
    assert history is not None
    changes = np.abs(np.diff(history.speed, axis=0)) / history.max_speed
    stops = (history.speed[1:] == 0.0) & (history.turn_rate[1:] == 0.0)
    most = float(changes[~stops].max())
    assert (most <= 0.02 / SPEC.ramp + 1e-9) == law.ramp
    assert not law.ramp or most < MAX_CHANGE_SHARE


def test_no_ramp_is_no_ramp() -> None:
    at_once = scenarios.ramped(SIX, 0.0)
    without = LAWS["field"]._replace(ramp=False)
    first, same = (
        simulate(at_once, horizon=5.0).error, simulate(SIX, law=without, horizon=5.0).error
    )  # fmt: skip
    assert np.array_equal(first, same)
    assert not np.array_equal(first, simulate(SIX, horizon=5.0).error)


@pytest.mark.parametrize("law", ["field", "proportional"])
def test_robots_settle_with_filter_and_ramp(law: str) -> None:
    result = simulate(scenarios.clearing(SIX), law=law, runs=40, horizon=60.0)
    assert result.converged.all()
    assert result.nearest.min() > 0.0


def test_proportional_law_settles_near_the_field_law() -> None:
    field, plain = (simulate(SIX, law=law, runs=40, horizon=40.0) for law in ("field", "proportional"))
    assert plain.converged.all()
    assert scenarios.median(plain) < 1.2 * scenarios.median(field)


def test_proportional_law_leaves_no_error_behind_a_steady_leader() -> None:
    result = simulate(scenarios.straight_chain(kind="proportional"), horizon=60.0)
    assert result.final_error[0] < 1e-3


def test_limits_are_taken_from_the_mission() -> None:
    assert SIX.control("robot2", LAWS["field"]).limits == Limits(
        SPEC.control_point_offset, SPEC.max_speed, SPEC.max_turn_rate
    )
