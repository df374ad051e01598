"""Commands ramp, whatever is wanted."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from formation.control.controller import Limits
from formation.control.ramp import slewed
from formation.control.unicycle import Command

LIMITS = Limits(0.1, 0.8, 2.0)
speeds, turn_rates = st.floats(-0.8, 0.8), st.floats(-2.0, 2.0)
commands = st.builds(Command, speeds, turn_rates)
shares = st.floats(0.0, 1.0)


@given(st.lists(st.tuples(commands, shares), min_size=1), commands)
def test_slewed_command_stays_within_limits_and_ramp(
    wishes: list[tuple[Command, float]], command: Command
) -> None:
    for wanted, share in wishes:
        before, command = command, slewed(command, wanted, LIMITS, share)
        assert abs(command.speed) <= LIMITS.max_speed
        assert abs(command.turn_rate) <= LIMITS.max_turn_rate
        if wanted != (0.0, 0.0):
            assert abs(command.speed - before.speed) <= share * LIMITS.max_speed * (1.0 + 1e-9) + 1e-15
            assert (
                abs(command.turn_rate - before.turn_rate)
                <= share * LIMITS.max_turn_rate * (1.0 + 1e-9) + 1e-15
            )


@given(commands, commands, st.floats(0.01, 1.0))
def test_ramp_reaches_wanted_command_exactly_and_stays(
    command: Command, wanted: Command, share: float
) -> None:
    for _ in range(int(2.0 / share) + 2):
        command = slewed(command, wanted, LIMITS, share)
    assert command == wanted
    assert slewed(command, wanted, LIMITS, 0.0) == wanted


@given(commands, shares)
def test_zero_velocity_never_waits(command: Command, share: float) -> None:
    assert slewed(command, Command(0.0, 0.0), LIMITS, share) == (0.0, 0.0)


@given(commands, commands, shares)
def test_it_only_ever_comes_nearer(before: Command, wanted: Command, share: float) -> None:
    after = slewed(before, wanted, LIMITS, share)
    assert abs(wanted.speed - after.speed) <= abs(wanted.speed - before.speed) + 1e-15
    assert abs(wanted.turn_rate - after.turn_rate) <= abs(wanted.turn_rate - before.turn_rate) + 1e-15
