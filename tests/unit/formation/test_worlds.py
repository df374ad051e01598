"""Both laws compared with theory, the paper's errata, and simulations with faults."""

from __future__ import annotations

import json
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest

from formation.control.observer import INNOVATION, PRINTED
from formation.mission.file import load
from formation.simulation.body import Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.unit.formation import scenarios

SIX = scenarios.six()


# Table of theory. `python -m tests.campaigns.bench.table` computes all of it with 400 starts.


@pytest.mark.slow
def test_field_law_settles_six_robots_seven_times_faster() -> None:
    paper = simulate(SIX, runs=200, law="paper", horizon=90.0)
    field = simulate(SIX, runs=200, law="field", horizon=30.0)
    assert paper.converged.mean() > 0.95
    assert field.converged.all()
    assert scenarios.median(paper) == pytest.approx(26.6, rel=0.1)
    assert scenarios.median(field) < 3.7
    assert np.percentile(field.settling_time, 95) < 4.9
    assert scenarios.median(paper) > 7.0 * scenarios.median(field)


@pytest.mark.slow
def test_field_law_settles_turtlebot_pair_six_times_faster() -> None:
    pair = scenarios.pair()
    paper = simulate(pair, runs=200, law="paper", horizon=90.0)
    field = simulate(pair, runs=200, law="field", horizon=30.0)
    assert scenarios.median(paper) == pytest.approx(33.6, rel=0.1)
    assert field.converged.all()
    assert scenarios.median(field) < 4.6


@pytest.mark.slow
def test_near_limit_only_field_law_settles_from_every_start() -> None:
    mission = scenarios.near_limit()
    paper = simulate(mission, runs=200, law="paper")
    field = simulate(mission, runs=30, law="field", horizon=120.0)
    assert paper.converged.mean() <= 0.5
    assert field.converged.all()
    assert scenarios.median(field) < 48.7 * 1.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay", "paper_errs", "field_errs"),
    [(0.0, (3.6, 19.0, 45.0), (0.08, 0.38, 0.84)), (0.1, (4.4, 23.0, 55.0), (0.13, 0.7, 1.5))],
)
def test_errors_on_circle_match_table_for_both_laws(
    delay: float, paper_errs: tuple[float, ...], field_errs: tuple[float, ...]
) -> None:
    mission = scenarios.circling_chain()
    for law, expected in (("paper", paper_errs), ("field", field_errs)):
        result = simulate(
            mission, law=law, options=Options(delay=delay), horizon=90.0, starts="random", keep=True
        )
        errs = scenarios.out_of_slot(mission, result)
        for hop, most in zip((1, 5, 11), expected, strict=True):
            assert errs[hop] < 1.1 * most
            assert law == "field" or errs[hop] > 0.9 * most


@pytest.mark.slow
def test_field_law_has_no_error_from_delay_behind_straight_leader() -> None:
    mission, late = scenarios.straight_chain(), Options(delay=0.1)
    errs = {
        law: scenarios.out_of_slot(
            mission, simulate(mission, law=law, options=late, horizon=90.0, starts="random", keep=True)
        )
        for law in ("paper", "field")
    }
    assert (errs["paper"][1], errs["paper"][11]) == pytest.approx((1.0, 11.0), rel=0.1)
    assert max(errs["field"]) < 0.005


# Errata


@pytest.mark.slow
def test_ring_of_twelve_diverges_and_ring_of_ten_settles() -> None:
    known = Options(observer=INNOVATION)  # tests the law, not the first heading estimate
    ten, twelve = (
        simulate(scenarios.ring(size), runs=10, law="paper", spread=0.05, options=known, horizon=80.0)
        for size in (10, 12)
    )
    assert ten.converged.all()
    assert not twelve.converged.any()
    assert np.all(twelve.final_error > 10.0 * twelve.error[0])


@pytest.mark.slow
def test_printed_observer_converges_from_few_starts() -> None:
    result = simulate(SIX, runs=50, law="paper", options=Options(observer=PRINTED), horizon=60.0)
    assert result.converged.mean() < 0.1
    assert np.median(result.final_error) > 20.0


# Faults


def test_all_runs_converge_with_30_percent_sample_loss() -> None:
    result = simulate(SIX, runs=20, horizon=40.0, options=Options(loss=0.3))
    assert result.converged.all()
    assert 2.0 < scenarios.median(result) < 6.0


def test_robot_without_messages_stands_still() -> None:
    result = simulate(SIX, horizon=5.0, options=Options(loss=1.0), keep=True)
    assert result.history is not None
    deaf = result.history.time > 0.2
    assert np.abs(result.history.speed[deaf]).max() == 0.0
    assert np.abs(result.history.turn_rate[deaf]).max() == 0.0


def test_delay_compensation_removes_error_from_late_samples() -> None:
    late = Options(delay=0.1)
    with_it = simulate(scenarios.straight_chain(), options=late, horizon=40.0)
    without = simulate(scenarios.straight_chain(delay_compensation=False), options=late, horizon=40.0)
    assert with_it.final_error[0] < 1e-3
    assert without.final_error[0] > 0.01


@pytest.mark.parametrize(("delay", "lag"), [(0.3, 0.0), (0.5, 0.0), (0.6, 0.2), (1.0, 1.0)])
def test_positions_are_extrapolated_by_the_believed_age(delay: float, lag: float) -> None:
    result = simulate(scenarios.straight_chain(), options=Options(delay=delay), horizon=60.0, keep=True)
    first = scenarios.out_of_slot(scenarios.straight_chain(), result)[1]  # [cm], at 0.1 m/s
    assert first == pytest.approx(10.0 * lag, rel=0.1, abs=0.05)


def test_local_measurement_has_neither_delay_nor_loss() -> None:
    seen_locally = Options(measurement="local")
    deaf = replace(seen_locally, delay=0.5, loss=1.0)
    clean, worse = (simulate(SIX, runs=3, horizon=20.0, options=options) for options in (seen_locally, deaf))
    assert worse.final_error.tolist() == clean.final_error.tolist()
    assert clean.converged.all()


@pytest.mark.slow
def test_unnormalised_equation_7_fails_from_most_starts() -> None:
    printed = Options(measurement="local", normalised=False)
    assert simulate(SIX, runs=60, law="paper", options=printed, horizon=90.0).converged.mean() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "bound"), [(0.001, 0.0036), (0.005, 0.018), (0.02, 0.045)])
def test_noise_causes_less_error_with_field_than_paper_law(noise: float, bound: float) -> None:
    noisy = Options(body=Body(position_noise=noise))
    field, paper = (
        simulate(SIX, runs=20, horizon=horizon, law=law, options=noisy)
        for law, horizon in (("field", 20.0), ("paper", 80.0))
    )
    rms, reference = (np.sqrt(np.square(one.error[len(one.error) // 2 :]).mean()) for one in (field, paper))
    assert rms < bound
    assert rms < 0.62 * reference


def test_simulated_body_clamps_and_lags_commands() -> None:
    mission = scenarios.ramped(load("turtlebot3_pair"), 0.0)
    history = simulate(mission, horizon=30.0, keep=True).history
    assert history is not None
    assert np.abs(history.speed).max() <= 0.2108
    assert 0.0 < history.speed[1].max() < 0.05  # from rest, wheels that lag
    free = simulate(mission, horizon=30.0, keep=True, options=Options(body=Body())).history
    assert free is not None
    assert np.abs(free.speed[1]).max() > 0.15  # at once


@pytest.mark.slow
def test_diverging_run_does_not_converge_and_raises_no_warnings() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = simulate(
            SIX, runs=4, law="paper", horizon=60.0, options=Options(observer=PRINTED, normalised=False)
        )
    assert not result.converged.any()
    json.dumps(result.summary(), allow_nan=False)


@pytest.mark.slow
def test_ten_thousand_robots_are_simulated_by_array_steps() -> None:
    side = 100
    grid = -(np.arange(side * side) % side) - 1j * (np.arange(side * side) // side)
    behind = [() if i == 0 else (i - 1 if i % side else i - side,) for i in range(side * side)]
    mission, called = scenarios.build(grid.astype(np.complex128), behind), [0]

    def calls(seconds: float) -> int:
        def count(_frame: object, event: str, _what: object) -> None:
            called[0] += event in {"call", "c_call"}

        before, called[0] = sys.getprofile(), 0
        sys.setprofile(count)
        try:
            result = simulate(mission, horizon=seconds, step=0.05)
        finally:
            sys.setprofile(before)
        assert result.robot_steps == round(seconds / 0.05) * (side * side - 1)
        return called[0]

    calls(0.1)  # one-time setup
    assert calls(1.1) - calls(0.1) < 20 * side
