"""What theory says of both laws, the errata, and worlds that are worse than theory's."""

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


# Theory's table. `python -m tests.campaigns.bench.table` makes all of it with 400 starts.


@pytest.mark.slow
def test_six_robots_settle_six_times_as_fast_by_the_field_law() -> None:
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
def test_near_limit_only_field_law_settles_from_everywhere() -> None:
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
def test_on_a_circle_the_field_law_errs_fifty_times_less(
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
def test_behind_a_straight_leader_late_samples_cost_the_field_law_nothing() -> None:
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
def test_the_ring_of_twelve_diverges_and_the_ring_of_ten_settles() -> None:
    known = Options(observer=INNOVATION)  # so that it is the law that is tested, not the first guess
    ten, twelve = (
        simulate(scenarios.ring(size), runs=10, law="paper", spread=0.05, options=known, horizon=80.0)
        for size in (10, 12)
    )
    assert ten.converged.all()
    assert not twelve.converged.any()
    assert np.all(twelve.final_error > 10.0 * twelve.error[0])


@pytest.mark.slow
def test_by_the_observer_as_printed_hardly_any_start_converges() -> None:
    result = simulate(SIX, runs=50, law="paper", options=Options(observer=PRINTED), horizon=60.0)
    assert result.converged.mean() < 0.1
    assert np.median(result.final_error) > 20.0


# A worse world


def test_lost_samples_slow_the_formation_down_but_do_not_break_it() -> None:
    result = simulate(SIX, runs=20, horizon=40.0, options=Options(loss=0.3))
    assert result.converged.all()
    assert 3.0 < scenarios.median(result) < 8.0


def test_robot_without_messages_stands_still() -> None:
    result = simulate(SIX, horizon=5.0, options=Options(loss=1.0), keep=True)
    assert result.history is not None
    deaf = result.history.time > 0.2
    assert np.abs(result.history.speed[deaf]).max() == 0.0
    assert np.abs(result.history.turn_rate[deaf]).max() == 0.0


def test_delay_compensation_is_what_makes_late_samples_cost_nothing() -> None:
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


def test_sensor_on_the_robot_has_neither_delay_nor_loss() -> None:
    seen_locally = Options(measurement="local")
    deaf = replace(seen_locally, delay=0.5, loss=1.0)
    clean, worse = (simulate(SIX, runs=3, horizon=20.0, options=options) for options in (seen_locally, deaf))
    assert worse.final_error.tolist() == clean.final_error.tolist()
    assert clean.converged.all()


@pytest.mark.slow
def test_equation_7_as_it_stands_fails_from_most_starts() -> None:
    printed = Options(measurement="local", normalised=False)
    assert simulate(SIX, runs=60, law="paper", options=printed, horizon=90.0).converged.mean() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "bound"), [(0.001, 0.0036), (0.005, 0.018), (0.02, 0.045)])
def test_noise_leaves_less_than_with_the_paper_law(noise: float, bound: float) -> None:
    noisy = Options(body=Body(position_noise=noise))
    field, paper = (
        simulate(SIX, runs=20, horizon=horizon, law=law, options=noisy)
        for law, horizon in (("field", 20.0), ("paper", 80.0))
    )
    rms, reference = (np.sqrt(np.square(one.error[len(one.error) // 2 :]).mean()) for one in (field, paper))
    assert rms < bound
    assert rms < 0.62 * reference


def test_the_firmware_of_the_mission_clamps_lags_and_cuts_commands() -> None:
    mission = scenarios.ramped(load("turtlebot3_pair"), 0.0)
    history = simulate(mission, horizon=30.0, keep=True).history
    assert history is not None
    assert np.abs(history.speed).max() <= 0.2108
    assert 0.0 < history.speed[1].max() < 0.05  # from rest, wheels that lag
    free = simulate(mission, horizon=30.0, keep=True, options=Options(body=Body())).history
    assert free is not None
    assert np.abs(free.speed[1]).max() > 0.15  # at once


@pytest.mark.slow
def test_diverging_run_has_not_converged_and_warns_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = simulate(
            SIX, runs=4, law="paper", horizon=60.0, options=Options(observer=PRINTED, normalised=False)
        )
    assert not result.converged.any()
    json.dumps(result.summary(), allow_nan=False)


@pytest.mark.slow
def test_ten_thousand_robots_are_steps_of_arrays_and_not_of_robots() -> None:
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

    calls(0.1)  # what is made once
    assert calls(1.1) - calls(0.1) < 20 * side
