"""Which messages are too old to act on."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.protocol.lateness import (
    CLEAR_SHARE,
    MAX_CLOCK_DRIFT,
    MAX_LATENESS_SPREAD,
    MAX_RECOVERY_TIME,
    RECOVERY_TIME,
    SETTLED_TIME,
    Count,
    Trust,
    counted,
    delayed,
    own_age_limit,
    quickest,
    trusted,
)

PERIOD = 0.05
LIMIT = 1.0


@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=50), st.floats(-1e6, 1e6), st.floats(-1e-4, 1e-4))
def test_lateness_is_relative_to_quickest_message(ways: list[float], offset: float, drift: float) -> None:
    known = quickest(offset, ways[0])
    for number, way in enumerate(ways):
        sent = number * PERIOD
        stamp, arrived = sent * (1.0 + drift) + offset, sent + way
        late = known.lateness(stamp, arrived)
        # clocks that run apart by less than MAX_CLOCK_DRIFT make nothing late by themselves
        assert late <= way - min(ways[: number + 1]) + 1e-6 + (MAX_CLOCK_DRIFT + 1e-4) * 50 * PERIOD
        known = known.followed_by(stamp, arrived)


def test_drift_of_clocks_does_not_accumulate() -> None:
    known = quickest(0.0, 0.0)
    for second in range(1, 3600):
        stamp = second * (1.0 - 1e-4)
        assert known.lateness(stamp, second) <= 0.0
        known = known.followed_by(stamp, second)


def test_constant_lateness_settles_after_a_minute() -> None:
    series = None
    for second in range(int(SETTLED_TIME) + 1):
        series = delayed(series, second - 3.0, float(second))
        assert series.settled(float(second)) == (second >= SETTLED_TIME)


def test_changing_lateness_never_settles() -> None:
    series = None
    for second in range(600):
        series = delayed(series, second * 0.9, float(second))
        assert not series.settled(float(second))
        assert series.most - series.least <= MAX_LATENESS_SPREAD


def test_counted_measures_lateness_against_quickest_beat() -> None:
    known: Count | None = None
    for beat in range(100):
        known, late = counted(known, 1, beat * PERIOD, 2.0 * beat * PERIOD, LIMIT)
        assert late == pytest.approx(beat * PERIOD, rel=4.0 * MAX_CLOCK_DRIFT, abs=1e-6)
    known, late = counted(known, 1, 200 * PERIOD, 200 * PERIOD, LIMIT)
    assert late <= 0.0


def test_later_term_resets_lateness() -> None:
    known, _ = counted(None, 1, 0.0, 0.0, LIMIT)
    known, late = counted(known, 2, 0.0, 50.0, LIMIT)
    assert (known.term, late) == (2, 0.0)


@pytest.mark.parametrize(
    ("neighbours", "k_p", "k_i", "limit"), [(2, 2.0, 1.0, 0.18), (1, 2.0, 1.0, 0.324), (4, 10.0, 0.0, 0.1)]
)
def test_own_age_limit_is_half_the_delay_margin(
    neighbours: int, k_p: float, k_i: float, limit: float
) -> None:
    assert own_age_limit(neighbours, k_p, k_i, 20.0, 0.5) == pytest.approx(limit, abs=0.005)


def test_own_age_limit_is_bounded() -> None:
    assert own_age_limit(1, 0.1, 0.01, 20.0, 0.5) == 0.5
    assert own_age_limit(0, 2.0, 1.0, 20.0, 0.5) == 0.5


def test_trust_returns_for_ages_that_stay_near_the_limit() -> None:
    trust, moment = trusted(Trust(), 0.31, 0.3, 0.0), 0.0
    while trust.held:
        moment += 0.05
        trust = trusted(trust, 0.29, 0.3, moment)
        assert moment < 11.0
    assert moment >= MAX_RECOVERY_TIME
    again = trusted(trusted(trust, 0.31, 0.3, 20.0), 0.29, 0.3, 21.0)
    assert again.held
    assert not trusted(again, 0.29, 0.3, 21.0 + MAX_RECOVERY_TIME).held


def test_trust_has_hysteresis() -> None:
    trust = trusted(Trust(), 0.31, 0.3, 0.0)
    assert trust.held
    for number in range(100):  # just below the limit is not enough
        trust = trusted(trust, 0.29, 0.3, 0.05 * number)
        assert trust.held
    since = 5.0
    while trust.held:
        trust = trusted(trust, CLEAR_SHARE * 0.3 - 0.01, 0.3, since)
        since += 0.05
        assert since < 6.0
    assert since >= 5.0 + RECOVERY_TIME
    assert not trusted(trust, 0.29, 0.3, since).held
    assert trusted(trust, math.inf, 0.3, since).held
