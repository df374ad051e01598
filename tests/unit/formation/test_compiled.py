"""What is compiled is what robots run: the same functions give the same numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.control.controller import Gains, Limits, Measured
from formation.control.laws import LAWS
from formation.control.observer import Travel, innovation, mended
from formation.control.quantiser import Quantiser, quantise
from formation.control.ramp import Ramp, ramp_limits, ramped
from formation.control.tracker import Track, seen
from formation.control.unicycle import Command, advance, driven
from formation.mission.model import Mission
from formation.simulation import compiled as maker
from formation.simulation.body import PROFILES, obeyed
from formation.simulation.compiled import compiled, magnitude
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result, simulate
from tests.unit.formation import scenarios
from tests.unit.formation.planar import gains, headings, lengths, vectors

rates = st.floats(-3.0, 3.0)


def flat(value: Any) -> list[complex]:
    """Every number in it."""
    return [number for part in value for number in flat(part)] if isinstance(value, tuple) else [value]


def alike(function: Any, *given: Any) -> None:
    assert flat(compiled(function)(*given)) == pytest.approx(flat(function(*given)), rel=1e-12, abs=1e-12)


@given(vectors, headings, rates, rates)
def test_robots_go_where_they_go(position: complex, heading: complex, speed: float, turn_rate: float) -> None:
    alike(advance, position, heading, speed, turn_rate, 0.3)


@pytest.mark.parametrize("law", [one.step for one in LAWS.values()], ids=LAWS)
@given(vectors, headings, st.builds(Measured, vectors, vectors, st.just(2.0), vectors), lengths, gains)
def test_laws_say_what_they_say(
    law: Any, integral: complex, heading: complex, measured: Measured, limit: float, gain: float
) -> None:
    alike(law, integral, heading, measured, Gains(gain, 1.0), Limits(0.1, limit, 2.0 * limit), 0.05)


@pytest.mark.parametrize("observer", [innovation, mended])
@given(vectors, st.builds(Travel, rates, rates, vectors), gains)
def test_observers_learn_what_they_learn(
    observer: Any, estimate: complex, travel: Travel, gain: float
) -> None:
    alike(observer, estimate, travel, gain)


@given(vectors, vectors, vectors)
def test_neighbours_are_known_as_they_are_known(was: complex, point: complex, velocity: complex) -> None:
    alike(seen, Track(0.0, was, velocity), 0.05, point, 0.1, 0.5)


@given(st.builds(Command, rates, rates), st.builds(Command, rates, rates))
def test_bodies_do_what_they_do(before: Command, reported: Command) -> None:
    body = PROFILES["turtlebot3_burger"]
    alike(obeyed, body, reported)
    alike(driven, before, reported, body.lag, 0.05)


@given(st.builds(Command, st.floats(-0.2, 0.2), st.floats(-2.0, 2.0)))
def test_commands_are_cut_as_they_are_cut(wanted: Command) -> None:
    cuts = Quantiser.of(Command(0.01, 0.01), Limits(0.05, 0.2108, 2.635))
    alike(quantise, cuts, wanted, Command(0.004, -0.004))


@given(st.builds(Command, st.floats(-0.2, 0.2), st.floats(-2.0, 2.0)), st.floats(0.0, 0.5))
def test_commands_ramp_as_they_ramp(wanted: Command, silence: float) -> None:
    ramp, limits = Ramp(Command(0.1, -1.0), 3.0, 0.0), Limits(0.05, 0.2108, 2.635)
    alike(ramped, ramp, wanted, 3.0 + silence, limits, ramp_limits(0.25, 20.0))


@given(st.complex_numbers(max_magnitude=1e100))
def test_a_magnitude_is_the_absolute_value(value: complex) -> None:
    assert magnitude(value) == pytest.approx(abs(value), rel=1e-12, abs=1e-150)


SIX, HARD = scenarios.six(), Options(delay=0.06, loss=0.1, body=PROFILES["turtlebot3_burger"])
AVOIDING = {"nobody": SIX, "neighbours": scenarios.exchanged(SIX, avoid=()), "all": scenarios.exchanged(SIX)}
STEPPED = SIX.model_copy(
    update={
        "robots": {
            name: robot.model_copy(update={"speed_step": 0.01, "turn_rate_step": 0.01})
            for name, robot in SIX.robots.items()
        }
    }
)


def by_python(monkeypatch: pytest.MonkeyPatch, mission: Mission = SIX, **more: Any) -> Result:
    """As it is where numba is not installed."""
    monkeypatch.setattr(maker, "AVAILABLE", False)
    monkeypatch.setattr("formation.simulation.ensemble.AVAILABLE", False)
    maker._compiled.cache_clear()
    try:
        return simulate(mission, runs=2, step=0.02, **more)
    finally:
        maker._compiled.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("mission", AVOIDING.values(), ids=AVOIDING)
@pytest.mark.parametrize("options", [Options(), HARD, Options(measurement="local")])
def test_without_a_compiler_the_same_comes_out(
    options: Options, mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = simulate(mission, runs=2, step=0.02, options=options, horizon=2.0)
    slow = by_python(monkeypatch, mission, options=options, horizon=2.0)
    assert slow.nearest == pytest.approx(quick.nearest, rel=1e-6, abs=1e-9)
    assert slow.error == pytest.approx(quick.error, rel=1e-6, abs=1e-9)


Said = tuple[Command, complex]


def still(
    integral: complex, _heading: complex, _measured: Measured, _gains: Gains, _limits: Limits, _dt: float
) -> Said:
    return Command(0.0, 0.0), integral


def mad(
    integral: complex, _heading: complex, _measured: Measured, _gains: Gains, _limits: Limits, dt: float
) -> Said:
    return Command(1.0, 1e308 / dt), integral


def lost(
    integral: complex, _heading: complex, _measured: Measured, _gains: Gains, _limits: Limits, _dt: float
) -> Said:
    return Command(math.nan, math.nan), integral


@pytest.mark.slow
@given(st.integers(1, 3))
@settings(max_examples=3)
def test_any_law_can_be_simulated(runs: int) -> None:
    result = simulate(
        SIX, runs=runs, law=LAWS["field"]._replace(name="still", step=still), horizon=1.0, keep=True
    )
    assert result.history is not None
    assert result.law == "still"
    assert np.ptp(result.history.position[:, 1:], axis=0).max() == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("law", "mission"), [(mad, SIX), (lost, SIX), (lost, STEPPED)])
def test_diverging_run_ends_with_and_without_compiler(
    law: Any, mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = LAWS["field"]._replace(name=law.__name__, step=law)
    quick = simulate(mission, runs=2, step=0.02, law=controller, horizon=1.0)
    with np.errstate(all="ignore"):
        slow = by_python(monkeypatch, mission, law=controller, horizon=1.0)
    for gone in (quick, slow):
        assert not gone.converged.any()
        assert gone.final_error.tolist() == [math.inf] * 2
        assert np.isinf(gone.error[1:]).all()
