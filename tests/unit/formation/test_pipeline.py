"""The control step that agents and simulation share, with its ramp and its quantiser."""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from formation.control.avoidance import Moving, Obstacle, brake
from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.laws import LAWS
from formation.control.pipeline import ControlState, Inputs, at_rest, control_step, law_command, quantised
from formation.control.quantiser import ROUNDING_FACTOR, Grid, Quantiser, nearest, quantise
from formation.control.ramp import MAX_CHANGE_SHARE, Ramp, slewed
from formation.control.unicycle import AT_REST, Command
from formation.mission.file import load
from formation.simulation.simulate import simulate
from tests.support.examples import slow
from tests.unit.formation import scenarios
from tests.unit.formation.planar import headings, vectors

SIX = load("six_robots")
SPEC = SIX.robots["robot2"]
PERIOD = 1.0 / SPEC.rate
AHEAD, GOES = Obstacle(0.25 + 0j, 0.1, 0j, first=True), Measured(10.0 + 0j, 0j, 1)
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def inputs(now: float, measured: Measured, heading: complex = 1.0 + 0.0j) -> Inputs:
    return Inputs(now, PERIOD, heading, measured, Gains(2.0, 1.0))


def stepped(before: Command, now: float = 1.0) -> ControlState:
    """The state one period after a command."""
    return ControlState(ramp=Ramp(before, now - PERIOD, -math.inf))


@every_law
@given(vectors, headings)
def test_commands_are_ramped_only_if_law_has_ramp(
    law: Controller, relative: complex, heading: complex
) -> None:
    params, measured = SIX.control("robot2", law), Measured(relative, 0j, 1)
    state, outcome = control_step(stepped(AT_REST), inputs(1.0, measured, heading), (), params)
    most = PERIOD / SPEC.ramp if law.ramp else 1.0
    assert abs(outcome.command.speed) <= most * SPEC.max_speed + 1e-9
    assert abs(outcome.command.turn_rate) <= most * SPEC.max_turn_rate + 1e-9
    assert state.ramp.before == outcome.command
    if not law.ramp:
        assert outcome.command == outcome.target


@pytest.mark.parametrize("ramp", [0.0, SPEC.ramp])
def test_command_of_law_is_cut_to_limits(ramp: float) -> None:
    unlimited = LAWS["proportional"]._replace(
        step=lambda integral, *_: (Command(-30.0, 500.0), integral), ramp=ramp > 0.0
    )
    params, state = SIX.control("robot2", unlimited), stepped(AT_REST)
    for step in range(1, 20):
        state, outcome = control_step(state, inputs(1.0 + step * PERIOD, GOES), (), params)
        assert abs(outcome.command.speed) <= SPEC.max_speed
        assert abs(outcome.command.turn_rate) <= SPEC.max_turn_rate
    assert outcome.command == (-SPEC.max_speed, SPEC.max_turn_rate)


@every_law
def test_obstacle_slows_robot_only_if_law_has_filter(law: Controller) -> None:
    params = SIX.control("robot2", law)
    known = (AHEAD,) if law.collision_filter else ()
    _, outcome = control_step(stepped(AT_REST), inputs(1.0, GOES), known, params)
    assert params.avoids == outcome.filtered == law.collision_filter
    assert (outcome.target.speed < 0.5 * SPEC.max_speed) == law.collision_filter


def test_warn_mode_changes_no_command() -> None:
    warns = SIX.model_copy(update={"collisions": SIX.collisions.model_copy(update={"mode": "warn"})})
    params, around = warns.control("robot2", LAWS["field"]), inputs(1.0, GOES)
    state = stepped(Command(SPEC.max_speed, 0.0))
    _, outcome = control_step(state, around, (AHEAD,), params)
    assert outcome.filtered
    assert outcome.command == law_command(state, around, params, params.limits)[0]


def test_brake_applies_after_the_ramp() -> None:
    params, state = SIX.control("robot2", LAWS["field"]), stepped(Command(SPEC.max_speed, 0.0))
    ahead = AHEAD._replace(at=0.45 + 0j)
    _, outcome = control_step(state, inputs(1.0, GOES), (ahead,), params)
    slowest, moving = SPEC.max_speed * (1.0 - PERIOD / SPEC.ramp), Moving(0.0, SPEC.max_speed)
    assert outcome.command == brake(Command(slowest, 0.0), [ahead], params.avoidance, moving)
    assert 0.0 < outcome.command.speed < 0.3 * slowest
    assert brake(Command(slowest, 0.0), [ahead], params.avoidance) != outcome.command


def test_robot_that_still_rolls_brakes_sooner() -> None:
    """Its mean speed counts where that is higher than its last command."""
    params, state = SIX.control("robot2", LAWS["field"]), stepped(AT_REST)
    ahead, known = AHEAD._replace(at=0.5 + 0j), inputs(1.0, GOES)
    standing, rolling = (
        control_step(state, known._replace(speed=speed), (ahead,), params)[1].target.speed
        for speed in (0.0, 1.5)
    )
    half = 0.5 * (0.5 - 2.0 * SPEC.radius - SIX.collisions.room)
    assert standing > rolling == pytest.approx((half - 1.5 * SIX.collisions.lag) / params.avoidance.hold)


@every_law
def test_non_finite_command_is_reported_and_keeps_ramp_state(law: Controller) -> None:
    params = SIX.control("robot2", law)
    state, outcome = control_step(stepped(AT_REST), inputs(1.0, Measured(math.nan * 1j, 0j, 1)), (), params)
    assert not outcome.finite
    assert state.ramp == stepped(AT_REST).ramp


def test_at_rest_resets_only_ramp_and_remainder() -> None:
    state = ControlState(1.0 + 2.0j, ramp=Ramp(Command(0.5, 0.1), 0.0, 0.3), remainder=Command(0.004, 0.0))
    assert at_rest(state, 2.0) == state._replace(ramp=Ramp(AT_REST, 2.0, 0.3), remainder=AT_REST)


@pytest.mark.parametrize("step", [0.0, 0.02, 0.05])
def test_short_simulation_step_does_not_change_control_parameters(step: float) -> None:
    for law in LAWS.values():
        assert SIX.control("robot2", law, step) == SIX.control("robot2", law)


def test_ramp_gap_and_hold_cover_longer_simulation_step() -> None:
    params = SIX.control("robot2", LAWS["field"], 0.2)
    assert params.ramp.gap > 0.2
    assert params.avoidance.hold >= 0.2


# In simulation


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(law, id=name, marks=() if name == "field" else pytest.mark.slow)
        for name, law in LAWS.items()  # every other law takes ten seconds to compile
    ],
)
def test_simulated_commands_change_no_faster_than_the_ramp(law: Controller) -> None:
    history = simulate(SIX, law=law, horizon=5.0, step=0.02, keep=True).history
    assert history is not None
    changes = np.abs(np.diff(history.speed, axis=0)) / history.max_speed
    stops = (history.speed[1:] == 0.0) & (history.turn_rate[1:] == 0.0)
    most = float(changes[~stops].max())
    assert (most <= 0.02 / SPEC.ramp + 1e-9) == law.ramp
    assert not law.ramp or most < MAX_CHANGE_SHARE


def test_zero_ramp_equals_law_without_ramp() -> None:
    at_once = scenarios.ramped(SIX, 0.0)
    without = LAWS["field"]._replace(ramp=False)
    first, same = (
        simulate(at_once, horizon=5.0).error, simulate(SIX, law=without, horizon=5.0).error
    )  # fmt: skip
    assert np.array_equal(first, same)
    assert not np.array_equal(first, simulate(SIX, horizon=5.0).error)


@pytest.mark.parametrize("law", ["field", *slow("proportional")])
def test_robots_settle_with_filter_and_ramp(law: str) -> None:
    result = simulate(scenarios.clearing(SIX), law=law, runs=40, horizon=60.0)
    assert result.converged.all()
    assert result.nearest.min() > 0.0


@pytest.mark.slow
def test_proportional_law_settles_almost_as_fast_as_field_law() -> None:
    field, plain = (simulate(SIX, law=law, runs=40, horizon=40.0) for law in ("field", "proportional"))
    assert plain.converged.all()
    assert scenarios.median(plain) < 1.25 * scenarios.median(field)


@pytest.mark.slow
def test_proportional_law_leaves_no_error_behind_a_steady_leader() -> None:
    result = simulate(scenarios.straight_chain(kind="proportional"), horizon=60.0)
    assert result.final_error[0] < 1e-3


def test_limits_are_taken_from_the_mission() -> None:
    assert SIX.control("robot2", LAWS["field"]).limits == Limits(
        SPEC.control_point_offset, SPEC.max_speed, SPEC.max_turn_rate, SPEC.max_speed / SPEC.ramp
    )
    assert SIX.control("robot2", LAWS["paper"]).limits.acceleration == math.inf


LIMITS = Limits(0.1, 0.8, 2.0)
speeds, turn_rates = st.floats(-0.8, 0.8), st.floats(-2.0, 2.0)
commands = st.builds(Command, speeds, turn_rates)
shares = st.floats(0.0, 1.0)


@given(commands, commands, st.floats(0.01, 1.0))
def test_ramp_reaches_wanted_command_exactly_and_stays(
    command: Command, wanted: Command, share: float
) -> None:
    for _ in range(int(2.0 / share) + 2):
        command = slewed(command, wanted, LIMITS, share)
    assert command == wanted
    assert slewed(command, wanted, LIMITS, 0.0) == wanted


@given(st.lists(st.tuples(commands, shares), min_size=1), commands)
def test_slewed_command_comes_nearer_within_limits_and_ramp(
    wishes: list[tuple[Command, float]], command: Command
) -> None:
    for wanted, share in wishes:
        before, command = command, slewed(command, wanted, LIMITS, share)
        for was, now, goal, most in zip(before, command, wanted, LIMITS[1:3], strict=True):
            assert abs(now) <= most
            assert abs(goal - now) <= abs(goal - was) + 1e-15
            assert wanted == NOTHING or abs(now - was) <= share * most * (1.0 + 1e-9) + 1e-15
        assert slewed(before, NOTHING, LIMITS, share) == NOTHING


TURTLEBOT_LIMITS = Limits(0.05, 0.2108, 2.635)
STEPS = Command(0.01, 0.01)
NOTHING = Command(0.0, 0.0)
TURTLEBOT = Quantiser.of(STEPS, TURTLEBOT_LIMITS)

turtlebot_speeds = st.floats(-0.2108, 0.2108)
turtlebot_turn_rates = st.floats(-2.635, 2.635)
turtlebot_commands = st.builds(Command, turtlebot_speeds, turtlebot_turn_rates)


def hundredths(value: float) -> int:
    """The number that a TurtleBot3 uses: `static_cast<int32_t>(value * 100)`."""
    return math.trunc(value * 100)


def sent(wanted: list[Command]) -> list[Command]:
    assert TURTLEBOT is not None
    remainder, out = NOTHING, []
    for command in wanted:
        one, remainder = quantise(TURTLEBOT, command, remainder)
        assert abs(remainder.speed) <= 0.01
        assert abs(remainder.turn_rate) <= 0.01
        out.append(one)
    return out


@given(st.lists(turtlebot_commands, max_size=60))
def test_quantised_commands_keep_limits_and_survive_truncation(wanted: list[Command]) -> None:
    for command in sent(wanted):
        assert abs(command.speed) <= 0.2108
        assert abs(command.turn_rate) <= 2.635
        for value in command:
            assert hundredths(value) == math.trunc(value / 0.01) == round(value / 0.01)
            assert math.copysign(1.0, value) == 1.0 or value < 0.0  # no negative zero


@pytest.mark.parametrize("step", [0.01, 0.001, 0.1, 1 / 3, 0.7])
def test_grid_multiples_survive_truncation_by_product_and_quotient(step: float) -> None:
    grid = Grid.of(step, 1000.0)
    for number in range(1, 1000):
        for sign in (-1, 1):
            value, remainder = nearest(grid, sign * number * step)
            assert math.trunc(value / step) == math.trunc(value * (1.0 / step)) == sign * number
            assert abs(remainder) < 1e-12


@given(st.lists(turtlebot_commands, min_size=1, max_size=300))
def test_accumulated_commands_stay_within_one_step_of_wishes(wanted: list[Command]) -> None:
    """Away from the limits and from rest, where nothing else changes commands."""
    moving = [Command(0.9 * c.speed, 0.9 * c.turn_rate) for c in wanted if c != NOTHING]
    reported = [(hundredths(c.speed), hundredths(c.turn_rate)) for c in sent(moving)]
    for axis in (0, 1):
        wanted_sums = accumulate(command[axis] for command in moving)
        told_sums = accumulate(0.01 * numbers[axis] for numbers in reported)
        assert all(abs(a - b) <= 0.01 for a, b in zip(wanted_sums, told_sums, strict=True))


@given(st.integers(1, 500), turtlebot_speeds, st.sampled_from([-1.0, 1.0]))
def test_time_at_the_limit_is_not_compensated_afterwards(held: int, then: float, sign: float) -> None:
    after = sent([Command(sign * 0.2108, 0.0)] * held + [Command(then, 1.0)] * 20)[held:]
    assert abs(math.fsum(c.speed for c in after) - 20 * then) <= 0.02 + 20 * max(0.0, abs(then) - 0.21)


@given(st.lists(turtlebot_commands, max_size=30), st.lists(turtlebot_commands, max_size=30))
def test_rest_is_sent_unchanged_and_resets_remainder(before: list[Command], after: list[Command]) -> None:
    out = sent([*before, NOTHING, *after])
    assert out[len(before)] == NOTHING
    assert out[len(before) + 1 :] == sent(after)


@given(turtlebot_commands)
def test_zero_step_leaves_commands_unquantised(wanted: Command) -> None:
    assert quantised(wanted, NOTHING, Quantiser.of(NOTHING, TURTLEBOT_LIMITS)) == (wanted, NOTHING)
    only_turns = Quantiser.of(Command(0.0, 0.01), TURTLEBOT_LIMITS)
    command, remainder = quantise(only_turns, wanted, NOTHING)
    assert command.speed == wanted.speed
    assert remainder.speed == 0.0


@given(st.floats(1e-3, 10.0), st.floats(1e-3, 10.0))
@example(0.01, 0.29)  # which is cut to 0.28
@example(0.01, 0.2)
@example(0.1, 0.3)
@example(0.2, 0.2)
def test_limit_is_quantised_to_largest_multiple_surviving_truncation(step: float, limit: float) -> None:
    value, _ = nearest(Grid.of(step, limit), limit)
    number = math.trunc(value / step)
    assert value <= limit
    assert number == math.trunc(value * (1.0 / step)) == round(value / step)
    assert (number + 1) * step * ROUNDING_FACTOR > limit
    assert (step, limit) != (0.01, 0.2) or value == limit


def test_quantise_passes_nan_through() -> None:
    assert TURTLEBOT is not None
    command, _ = quantise(TURTLEBOT, Command(math.nan, 0.1), NOTHING)
    assert math.isnan(command.speed)
    assert command.turn_rate == pytest.approx(0.1)
