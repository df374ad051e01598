"""What theory says of both laws, and the paper's errata, in simulation."""

from __future__ import annotations

import numpy as np
import pytest

from formation.control.observer import INNOVATION, PRINTED
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.unit.formation import scenarios

SIX = scenarios.six()


# Theory's table. `python -m tests.campaigns.bench.table` makes all of it with 400 starts.


def test_six_robots_settle_six_times_as_fast_by_the_field_law() -> None:
    paper = simulate(SIX, runs=200, law="paper", horizon=90.0)
    field = simulate(SIX, runs=200, law="field", horizon=30.0)
    assert paper.converged.mean() > 0.95
    assert field.converged.all()
    assert scenarios.median(paper) == pytest.approx(26.6, rel=0.1)
    assert scenarios.median(field) < 4.4
    assert np.percentile(field.settling_time, 95) < 5.8
    assert scenarios.median(paper) > 6.0 * scenarios.median(field)


def test_the_observer_and_anti_windup_alone_settle_in_ten_seconds() -> None:
    plain = scenarios.six(feed_forward=False, delay_compensation=False, integral_band=1e6)
    assert scenarios.median(simulate(plain, runs=100, horizon=30.0)) == pytest.approx(9.9, rel=0.1)


def test_field_law_settles_turtlebot_pair_six_times_faster() -> None:
    pair = scenarios.pair()
    paper = simulate(pair, runs=200, law="paper", horizon=90.0)
    field = simulate(pair, runs=200, law="field", horizon=30.0)
    assert scenarios.median(paper) == pytest.approx(33.6, rel=0.1)
    assert field.converged.all()
    assert scenarios.median(field) == pytest.approx(5.0, rel=0.1)


@pytest.mark.slow
def test_near_limit_only_field_law_settles_from_everywhere() -> None:
    mission = scenarios.near_limit()
    paper = simulate(mission, runs=200, law="paper")
    field = simulate(mission, runs=30, law="field", horizon=120.0)
    assert paper.converged.mean() <= 0.5
    assert field.converged.all()
    assert scenarios.median(field) < 48.7 * 1.1


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
