"""Dead reckoning sampled at even moments, and the delay that it finds in measurements."""

from __future__ import annotations

from bisect import bisect
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.pose.motion_model import (
    GRID_COUNT,
    SPACING,
    WINDOW_STEPS,
    MotionModel,
    OwnDelay,
)
from formation.control.unicycle import Command

LONGEST, GAP = 0.5, 0.4
INTERVALS = st.lists(st.floats(0.004, 0.19), min_size=30, max_size=120)
SPEEDS = st.lists(st.floats(-0.5, 0.5), min_size=30, max_size=120)


@given(INTERVALS, SPEEDS)
def test_sampled_distances_are_those_of_the_path(intervals: list[float], speeds: list[float]) -> None:
    model, whole = MotionModel(LONGEST, GAP), [(3.0, 0j)]
    model.go_to(3.0)
    for interval, speed in zip(intervals, speeds, strict=False):
        model.commanded(whole[-1][0], Command(speed, 0.3 * speed))
        model.go_to(whole[-1][0] + interval)
        whole.append((model.now.moment, model.now.position))

    def at(moment: float) -> complex:
        after = min(bisect(whole, moment, key=lambda one: one[0]), len(whole) - 1)
        (begin, first), (end, last) = whole[after - 1], whole[after]
        return first + min(1.0, max(0.0, (moment - begin) / (end - begin))) * (last - first)

    newest = model.state.path.tick
    for later in (0, 2):
        for delay, distance in enumerate(model.distances(newest - later)):
            end = (newest - later - delay) * SPACING
            if end - WINDOW_STEPS * SPACING > whole[0][0]:
                assert distance == pytest.approx(abs(at(end) - at(end - WINDOW_STEPS * SPACING)), abs=1e-9)


@given(st.integers(0, GRID_COUNT - 1), st.floats(0.005, 0.15), st.integers(0, 2**32))
def test_the_delay_of_measurements_is_found(steps: int, period: float, seed: int) -> None:
    random = Random(seed)
    delay, model, found = steps * SPACING, MotionModel(LONGEST, GAP), OwnDelay(noise=0.0)
    path, moment, last, command = [(0.0, 0j)], 2.0, 0j, 0.0
    model.go_to(moment)
    for count in range(round(12.0 / period)):
        if count % max(1, round(0.4 / period)) == 0:
            command = random.uniform(-0.6, 0.6)
        model.commanded(moment, Command(command, 0.0))
        moment += period * random.uniform(0.7, 1.3)
        model.go_to(moment)
        path.append((moment, model.now.position))
        number = max(1, min(bisect(path, moment - delay, key=lambda one: one[0]), len(path) - 1))
        (begin, first), (end, then) = path[number - 1], path[number]
        seen = first + max(0.0, moment - delay - begin) / (end - begin) * (then - first)
        found.add(moment, seen - last, model)
        last = seen
    misfits = found.misfits()
    assert abs(misfits.index(min(misfits)) - steps) <= 1 + period / SPACING
    if 0.5 < delay < 1.2 and period < 0.06:
        assert found.judge(0.3) == pytest.approx(delay, abs=0.11)
    assert found.judge(delay + 0.1) is None


def test_a_long_pause_costs_no_more_than_is_kept() -> None:
    model = MotionModel(LONGEST, GAP)
    for count in range(100):
        model.commanded(3.0 + 0.02 * count, Command(0.2, 0.0))
    model.go_to(1e7)
    assert model.distances(model.state.path.tick) == [0.0] * GRID_COUNT
    assert len(model.state.path.points) == WINDOW_STEPS
