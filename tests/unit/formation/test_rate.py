from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.transport.runtime.rate import Rate


def test_first_call_ticks_and_next_a_period_later() -> None:
    rate = Rate(20.0)
    assert rate.due == -math.inf
    assert rate.tick(100.0)
    assert rate.due == pytest.approx(100.05)
    assert not rate.tick(100.049)
    assert rate.tick(100.05)


@pytest.mark.parametrize(("late", "missed", "due"), [(0.13, 0, 0.2), (0.55, 4, 0.6)])
def test_late_tick_delays_no_other_and_missed_ones_are_counted(late: float, missed: int, due: float) -> None:
    rate = Rate(10.0)
    rate.tick(0.0)
    assert rate.tick(late)
    assert (rate.ticks, rate.missed) == (2, missed)
    assert rate.due == pytest.approx(due)
    assert not rate.tick(due - 0.04)


def test_phase_delays_first_tick_by_share_of_period() -> None:
    rate = Rate(10.0, phase=0.25)
    assert not rate.tick(5.0)
    assert rate.due == pytest.approx(5.025)
    assert rate.tick(5.03)
    assert rate.due == pytest.approx(5.125)


def test_a_clock_summed_up_in_floats_ticks_every_period() -> None:
    rate, now = Rate(20.0), 0.0
    for _ in range(20_000):
        assert rate.tick(now)
        now += 0.05
    assert rate.missed == 0


@given(st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=200), st.floats(0.0, 0.99))
def test_ticks_stay_on_grid_and_every_period_counts(pauses: list[float], phase: float) -> None:
    rate, now, ticks = Rate(25.0, phase), 10.0, []
    rate.tick(now)
    first = 10.0 + phase * rate.period
    for pause in pauses:
        now += pause
        before = rate.due
        if rate.tick(now):
            ticks.append(now)
            assert before <= now + 1e-6
        assert rate.due > now - 1e-6
        points = (rate.due - first) / rate.period
        assert points == pytest.approx(round(points), abs=1e-6)
        assert rate.ticks + rate.missed == round(points)
    assert all(later - earlier > 0.0 for earlier, later in pairwise(ticks))


@pytest.mark.parametrize(
    ("hertz", "phase"), [(0.0, 0.0), (-1.0, 0.0), (math.nan, 0.0), (math.inf, 0.0), (1.0, 1.0)]
)
def test_a_rate_that_cannot_be_is_refused(hertz: float, phase: float) -> None:
    with pytest.raises(ValueError, match="rate"):
        Rate(hertz, phase)
