"""Theorems on error feedback: nothing is lost to the robot's cut, nothing is owed for long, limits hold."""

from __future__ import annotations

import math
from itertools import accumulate

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from formation.control.controller import Limits
from formation.control.pipeline import quantised
from formation.control.quantiser import ROUNDING_FACTOR, Grid, Quantiser, nearest, quantise
from formation.control.unicycle import Command

LIMITS = Limits(0.05, 0.2108, 2.635)
STEPS = Command(0.01, 0.01)
NOTHING = Command(0.0, 0.0)
TURTLEBOT = Quantiser.of(STEPS, LIMITS)

speeds = st.floats(-0.2108, 0.2108)
turn_rates = st.floats(-2.635, 2.635)
commands = st.builds(Command, speeds, turn_rates)


def hundredths(value: float) -> int:
    """What a TurtleBot3 takes: `static_cast<int32_t>(value * 100)`."""
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


@given(st.lists(commands, max_size=60))
def test_every_limit_holds_and_every_command_survives_the_cut(wanted: list[Command]) -> None:
    for command in sent(wanted):
        assert abs(command.speed) <= 0.2108
        assert abs(command.turn_rate) <= 2.635
        for value in command:
            assert hundredths(value) == math.trunc(value / 0.01) == round(value / 0.01)
            assert math.copysign(1.0, value) == 1.0 or value < 0.0  # no negative zero


@pytest.mark.parametrize("step", [0.01, 0.001, 0.1, 1 / 3, 0.7])
def test_every_multiple_survives_a_cut_by_product_or_by_quotient(step: float) -> None:
    grid = Grid.of(step, 1000.0)
    for number in range(1, 1000):
        for sign in (-1, 1):
            value, remainder = nearest(grid, sign * number * step)
            assert math.trunc(value / step) == math.trunc(value * (1.0 / step)) == sign * number
            assert abs(remainder) < 1e-12


@given(st.lists(commands, min_size=1, max_size=300))
def test_accumulated_commands_stay_within_one_step_of_wishes(
    wanted: list[Command],
) -> None:
    """Away from the limits and from rest, where there is nothing else between the two."""
    moving = [Command(0.9 * c.speed, 0.9 * c.turn_rate) for c in wanted if c != NOTHING]
    reported = [(hundredths(c.speed), hundredths(c.turn_rate)) for c in sent(moving)]
    for axis in (0, 1):
        wanted_sums = accumulate(command[axis] for command in moving)
        told_sums = accumulate(0.01 * numbers[axis] for numbers in reported)
        assert all(abs(a - b) <= 0.01 for a, b in zip(wanted_sums, told_sums, strict=True))


@given(st.integers(1, 500), speeds, st.sampled_from([-1.0, 1.0]))
def test_time_at_the_limit_is_not_repaid_afterwards(held: int, then: float, sign: float) -> None:
    after = sent([Command(sign * 0.2108, 0.0)] * held + [Command(then, 1.0)] * 20)[held:]
    assert abs(math.fsum(c.speed for c in after) - 20 * then) <= 0.02 + 20 * max(0.0, abs(then) - 0.21)


@given(st.lists(commands, max_size=30), st.lists(commands, max_size=30))
def test_rest_is_rest_and_forgets_what_came_before(before: list[Command], after: list[Command]) -> None:
    out = sent([*before, NOTHING, *after])
    assert out[len(before)] == NOTHING
    assert out[len(before) + 1 :] == sent(after)


@given(commands)
def test_a_robot_that_takes_any_number_gets_what_is_wanted(wanted: Command) -> None:
    assert quantised(wanted, NOTHING, Quantiser.of(NOTHING, LIMITS)) == (wanted, NOTHING)
    only_turns = Quantiser.of(Command(0.0, 0.01), LIMITS)
    command, remainder = quantise(only_turns, wanted, NOTHING)
    assert command.speed == wanted.speed
    assert remainder.speed == 0.0


@given(st.floats(1e-3, 10.0), st.floats(1e-3, 10.0))
@example(0.01, 0.29)  # which is cut to 0.28
@example(0.01, 0.2)
@example(0.1, 0.3)
@example(0.2, 0.2)
def test_limit_is_quantised_to_largest_surviving_multiple(step: float, limit: float) -> None:
    value, _ = nearest(Grid.of(step, limit), limit)
    number = math.trunc(value / step)
    assert value <= limit
    assert number == math.trunc(value * (1.0 / step)) == round(value / step)
    assert (number + 1) * step * ROUNDING_FACTOR > limit


def test_a_limit_that_is_a_multiple_is_reached() -> None:
    assert nearest(Grid.of(0.01, 0.2), 0.2)[0] == 0.2


def test_what_is_no_number_is_not_sent_as_one() -> None:
    assert TURTLEBOT is not None
    command, _ = quantise(TURTLEBOT, Command(math.nan, 0.1), NOTHING)
    assert math.isnan(command.speed)
    assert command.turn_rate == pytest.approx(0.1)
