"""Compiled functions give the same numbers as the Python functions that robots run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
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
    """Every number in a nested tuple."""
    return [number for part in value for number in flat(part)] if isinstance(value, tuple) else [value]


BODY, LIMITS = PROFILES["turtlebot3_burger"], Limits(0.05, 0.2108, 2.635)
commands = st.builds(Command, rates, rates)
wishes = st.builds(Command, st.floats(-0.2, 0.2), st.floats(-2.0, 2.0))
travels = st.builds(Travel, rates, rates, vectors)
tracks = st.builds(Track, st.just(0.0), vectors, vectors)
sums = st.builds(Measured, vectors, vectors, st.just(2.0), vectors)
some_gains = st.builds(Gains, gains, st.just(1.0))
some_limits = lengths.map(lambda most: Limits(0.1, most, 2.0 * most))
CUTS, RAMP = Quantiser.of(Command(0.01, 0.01), LIMITS), Ramp(Command(0.1, -1.0), 3.0, 0.0)
FUNCTIONS: dict[str, tuple[Any, ...]] = {
    **{
        name: (one.step, vectors, headings, sums, some_gains, some_limits, 0.05) for name, one in LAWS.items()
    },
    "advance": (advance, vectors, headings, rates, rates, 0.3),
    "innovation": (innovation, vectors, travels, gains),
    "mended": (mended, vectors, travels, gains),
    "seen": (seen, tracks, 0.05, vectors, 0.1, 0.5),
    "obeyed": (obeyed, BODY, commands),
    "driven": (driven, commands, commands, BODY.lag, 0.05),
    "quantise": (quantise, CUTS, wishes, Command(0.004, -0.004)),
    "ramped": (ramped, RAMP, wishes, st.floats(3.0, 3.5), LIMITS, ramp_limits(0.25, 20.0)),
}
"""Functions, and values of their arguments or what draws them."""


@pytest.mark.parametrize("name", FUNCTIONS)
@given(st.data())
def test_compiled_function_gives_the_same_numbers(name: str, data: st.DataObject) -> None:
    function, *arguments = FUNCTIONS[name]
    values = [data.draw(one) if isinstance(one, st.SearchStrategy) else one for one in arguments]
    assert flat(compiled(function)(*values)) == pytest.approx(flat(function(*values)), rel=1e-12, abs=1e-12)


@given(st.complex_numbers(max_magnitude=1e100))
def test_magnitude_equals_absolute_value(value: complex) -> None:
    assert magnitude(value) == pytest.approx(abs(value), rel=1e-12, abs=1e-150)


SIX, HARD = scenarios.six(), Options(delay=0.06, loss=0.1, body=PROFILES["turtlebot3_burger"])
AVOIDING = {"none": SIX, "neighbours": scenarios.exchanged(SIX, avoid=()), "all": scenarios.exchanged(SIX)}
STEP = {"speed_step": 0.01, "turn_rate_step": 0.01}
STEPPED = SIX.changed(robots={name: one.model_copy(update=STEP) for name, one in SIX.robots.items()})


def by_python(monkeypatch: pytest.MonkeyPatch, mission: Mission = SIX, **more: Any) -> Result:
    """Simulate in plain Python, as without numba."""
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
def test_simulation_without_numba_gives_same_results(
    options: Options, mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = simulate(mission, runs=2, step=0.02, options=options, horizon=2.0)
    slow = by_python(monkeypatch, mission, options=options, horizon=2.0)
    assert slow.nearest == pytest.approx(quick.nearest, rel=1e-6, abs=1e-9)
    assert slow.error == pytest.approx(quick.error, rel=1e-6, abs=1e-9)


def still(integral: complex, *_: Any) -> tuple[Command, complex]:
    return Command(0.0, 0.0), integral


def infinite(integral: complex, *_: Any) -> tuple[Command, complex]:
    return Command(1.0, math.inf), integral


def not_a_number(integral: complex, *_: Any) -> tuple[Command, complex]:
    return Command(math.nan, math.nan), integral


@pytest.mark.slow
def test_user_defined_law_can_be_simulated() -> None:
    law = LAWS["field"]._replace(name="still", step=still)
    result = simulate(SIX, runs=2, law=law, horizon=1.0, keep=True)
    assert result.history is not None
    assert result.law == "still"
    assert np.ptp(result.history.position[:, 1:], axis=0).max() == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("law", "mission"), [(infinite, SIX), (not_a_number, SIX), (not_a_number, STEPPED)])
def test_diverging_run_ends_with_infinite_error(
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
