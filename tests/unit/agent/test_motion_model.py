"""Dead reckoning by commands, and the measurement delay found with it."""

from __future__ import annotations

from bisect import bisect
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.pose.motion_model import (
    LOOKBACK_COUNT,
    SPACING,
    MotionModel,
    OwnDelay,
    positions,
)
from formation.control.unicycle import Command
from tests.support.examples import slow

LONGEST, GAP = 0.5, 0.6
Path = list[tuple[float, complex]]
"""Moments [s] and positions [m]."""


def at(path: Path, moment: float) -> complex:
    """The position on a path at a moment; outside of it, at its nearer end."""
    after = min(max(bisect(path, moment, key=lambda one: one[0]), 1), len(path) - 1)
    (begin, first), (end, last) = path[after - 1], path[after]
    return first + min(1.0, max(0.0, (moment - begin) / (end - begin))) * (last - first)


@given(st.lists(st.floats(0.004, 0.19), min_size=2, max_size=120), st.integers(0, 2**32))
def test_back_returns_positions_on_the_path(intervals: list[float], seed: int) -> None:
    random, model, path = Random(seed), MotionModel(LONGEST, GAP), [(3.0, 0j)]
    model.go_to(3.0)
    for interval in intervals:
        model.commanded(path[-1][0], Command(random.uniform(-0.5, 0.5), random.uniform(-1.0, 1.0)))
        model.go_to(path[-1][0] + interval)
        path.append((model.now.moment, model.now.position))
    found = positions(model.back(SPACING, LOOKBACK_COUNT))
    expected = [at(path, path[-1][0] - number * SPACING) for number in range(LOOKBACK_COUNT)]
    assert found == pytest.approx(expected, abs=1e-9)


def delays_found(rate: float, delay: float, limit: float, seed: int, seconds: float = 30.0) -> list[float]:
    """Delays [s] found while a robot changes speed at random and its positions are `delay` [s] old."""
    random, model, estimate = Random(seed), MotionModel(LONGEST, 3.0 / rate), OwnDelay(0.0, rate)
    moment, last, path, found, due = 100.0, 0j, [(99.0, 0j), (100.0, 0j)], list[float](), 100.0
    model.go_to(moment)
    while moment < 100.0 + seconds:
        if moment >= due:
            due, speed = moment + random.uniform(0.3, 1.5), random.uniform(-0.6, 0.6)
        model.commanded(moment, Command(speed, 0.0))
        moment += random.uniform(0.7, 1.3) / rate
        model.go_to(moment)
        path.append((moment, model.now.position))
        seen = at(path, moment - delay)
        if estimate.add(moment, seen - last, model) and (late := estimate.judge(limit)) is not None:
            found.append(late)
        last = seen
    return found


@pytest.mark.parametrize("rate", [2.0, 20.0, 200.0, *slow(3.0, 5.0, 10.0, 50.0, 100.0)])
@pytest.mark.parametrize("seed", [1, *slow(2, 3, 4)])
def test_measurement_delay_is_found_at_every_rate(rate: float, seed: int) -> None:
    found = delays_found(rate, 1.0, 0.5 + 1.0 / rate if rate > 2.5 else 0.6, seed)
    assert found
    assert max(abs(one - 1.0) for one in found[len(found) // 2 :]) <= 0.1 + 0.2 / rate


@pytest.mark.parametrize("rate", [2.5, 20.0, 200.0, *slow(3.0, 5.0, 10.0, 50.0, 100.0)])
@pytest.mark.parametrize("seed", [1, *slow(*range(2, 40))])
def test_delay_within_limit_is_never_reported(rate: float, seed: int) -> None:
    delay = Random(seed).uniform(0.0, 0.4)
    assert delays_found(rate, delay, 0.5 + 1.0 / rate, seed, seconds=12.0) == []


def test_few_measurements_report_no_delay() -> None:
    arrivals, places = (
        [0.5767, 0.8957, 1.1196, 1.594, 1.7924, 2.1319],
        [0, 0, 0.0953, 0.0882, -0.1801, -0.5821],
    )
    commands = [(0.6067, 0.534), (0.8987, 0.534), (1.1206, -1.353), (1.624, -1.027), (1.8224, -1.027)]
    model, estimate = MotionModel(0.683, 1.0), OwnDelay(0.0, 3.0)
    model.go_to(arrivals[0])
    for number, (moment, speed) in enumerate(commands, start=1):
        model.commanded(moment, Command(speed, 0.0))
        model.go_to(arrivals[number])
        estimate.add(arrivals[number], complex(places[number] - places[number - 1]), model)
    assert estimate.judge(0.5 + 1.0 / 3.0) is None


def test_only_some_measurements_count_at_high_rate() -> None:
    model, estimate = MotionModel(LONGEST, GAP), OwnDelay(0.0, 200.0)
    counted = []
    for number in range(200):
        model.commanded(1.0 + 0.005 * number, Command(0.2, 0.0))
        counted.append(estimate.add(1.0 + 0.005 * number, 0.001 + 0j, model))
    assert counted.count(True) == 20
