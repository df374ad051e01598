from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.monitor.report.thin import Extremes, Samples, Size, Spread


def test_a_short_series_is_kept_as_it_is() -> None:
    series = Extremes(2)
    for i in range(100):
        series.add(10.0 + i, (i, -i))
    curves = series.curves(10.0)
    time, values = curves.line(1)
    assert time == pytest.approx(np.arange(100.0))
    assert values == pytest.approx(-np.arange(100.0))


def test_a_long_series_stays_bounded_keeps_its_beginning_and_every_peak() -> None:
    series = Extremes(1, most=64, head=16)
    for i in range(100_000):
        series.add(float(i), (1000.0 if i == 54_321 else np.sin(i),))
    curves = series.curves(0.0)
    assert len(curves.time) <= 64
    assert (curves.time[:16] == np.arange(16.0)).all()
    assert (curves.low[:16, 0] == np.sin(np.arange(16.0))).all()
    assert np.nanmax(curves.high) == 1000.0
    assert (np.diff(curves.time) > 0.0).all()
    peak = curves.time[np.argmax(curves.high[:, 0])]
    assert peak <= 54_321 <= peak + 2.0 * np.diff(curves.time).max()


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=400))
def test_thinning_loses_no_extreme(values: list[float]) -> None:
    series = Extremes(1, most=8, head=2)
    for i, value in enumerate(values):
        series.add(float(i), (value,))
    curves = series.curves(0.0)
    assert curves.low.min() == min(values)
    assert curves.high.max() == max(values)
    time, line = curves.line(0)
    assert len(time) == len(line) <= 16
    assert {min(values), max(values)} <= set(line)


def test_what_is_not_known_does_not_hide_what_is() -> None:
    series = Extremes(1, most=4, head=0)
    for i in range(64):
        series.add(float(i), (np.nan if i % 2 else 1.0,))
    assert (series.curves(0.0).low == 1.0).all()


def test_vectors_are_thinned_to_the_first_of_each_few() -> None:
    ways = Samples(1, most=32, head=8)
    for i in range(5_000):
        ways.add(float(i), (complex(i, -i),))
    time, rows = ways.taken(0.0)
    assert len(time) <= 32
    assert (rows[:, 0].real == time).all()


def test_thinned_percentiles_stay_accurate_and_keep_maximum() -> None:
    spread = Spread(drawn=1024)
    for i in range(100_000):
        spread.add(i / 100_000)
    spread.add(7.0)
    assert spread.percentile(0.5) == pytest.approx(0.5, abs=0.01)
    assert spread.percentile(0.99) == pytest.approx(0.99, abs=0.01)
    assert (spread.count, spread.most) == (100_001, 7.0)
    assert len(spread._values) <= 1024


def test_of_nothing_there_is_no_percentile_and_no_rms() -> None:
    assert Spread().percentile(0.5) is None
    assert Size().rms is None
    assert Size().maximum is None


def test_rms_and_maximum_are_of_magnitudes() -> None:
    size = Size()
    for value in (3.0, -4.0):
        size.add(value)
    assert size.maximum == 4.0
    assert size.rms == pytest.approx((12.5) ** 0.5)
