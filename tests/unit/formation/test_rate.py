from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.transport.runtime.rate import TICK_TOLERANCE, Rate


def test_rate_ticks_every_period_despite_float_rounding() -> None:
    rate, now = Rate(20.0), 0.0
    for _ in range(20_000):
        assert rate.tick(now)
        now += 0.05
    assert rate.missed == 0


@given(st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=200), st.floats(0.0, 0.99))
def test_ticks_stay_on_grid_and_every_period_is_counted(pauses: list[float], phase: float) -> None:
    rate, now = Rate(25.0, phase), 10.0
    assert rate.due == -math.inf
    ticks = int(rate.tick(now))
    assert ticks == (phase * rate.period <= TICK_TOLERANCE)
    first = 10.0 + phase * rate.period
    for pause in pauses:
        now += pause
        before = rate.due
        if rate.tick(now):
            ticks += 1
            assert before <= now + 1e-6
        assert rate.due > now - 1e-6
        points = (rate.due - first) / rate.period
        assert points == pytest.approx(round(points), abs=1e-6)
        assert points * rate.period <= now + rate.period - first + 1e-6  # the next point, none later
        assert rate.ticks == ticks
        assert rate.ticks + rate.missed == round(points)


@pytest.mark.parametrize(
    ("hertz", "phase"), [(0.0, 0.0), (-1.0, 0.0), (math.nan, 0.0), (math.inf, 0.0), (1.0, 1.0)]
)
def test_invalid_rate_or_phase_is_refused(hertz: float, phase: float) -> None:
    with pytest.raises(ValueError, match="rate"):
        Rate(hertz, phase)
