"""Tracks of neighbours: velocity, delay, and late or lost samples."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.tracker import (
    FORGETTING_SILENCE,
    Track,
    believed_delay,
    carried_to,
    first_seen,
    learned,
    longest_delay,
    seen,
)
from formation.simulation.neighbours import Link, arrived, carried, is_fresh
from tests.unit.formation.planar import vectors

TAU, FASTEST = 0.1, 100.0
velocities = st.builds(complex, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


def follow(track: Track, velocity: complex, period: float, seconds: float) -> Track:
    for _ in range(round(seconds / period)):
        track = seen(track, track.stamp + period, track.point + velocity * period, TAU, FASTEST)
    return track


@given(vectors)
def test_neighbour_seen_once_has_zero_velocity(point: complex) -> None:
    assert carried_to(first_seen(5.0, point), 5.3, 1.0) == point
    assert arrived(NEVER, 3.0, point, 1.0, TOP) == (3.0, point, 0j)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1e9), st.floats(0.1, 3.0))
def test_only_plausible_delays_are_believed(share: float, off: float, longest: float) -> None:
    assert believed_delay(share * longest, longest) == pytest.approx(share * longest)
    assert believed_delay(-off, longest) == 0.0
    assert believed_delay(2.0 * longest + off, longest) == 0.0


@given(vectors, velocities, st.sampled_from([0.01, 0.02, 0.05]))
def test_velocity_is_learned_at_any_sample_rate(point: complex, velocity: complex, period: float) -> None:
    track = follow(first_seen(0.0, point), velocity, period, 0.1)
    assert track.velocity == pytest.approx(velocity * (1.0 - math.exp(-1.0)), abs=1e-9)
    assert follow(track, velocity, period, 3.0).velocity == pytest.approx(velocity, abs=1e-9)


@given(vectors, velocities, st.floats(0.0, 0.15))
def test_late_sample_of_steady_neighbour_is_extrapolated(
    point: complex, velocity: complex, age: float
) -> None:
    track = follow(first_seen(0.0, point), velocity, 0.05, 4.0)
    assert carried_to(track, 4.0 + age, 0.15) == pytest.approx(point + velocity * (4.0 + age), abs=1e-9)


def test_extrapolation_is_limited_forwards_and_backwards() -> None:
    track = Track(1.0, 0j, 2.0 + 0j)
    assert carried_to(track, 9.0, 0.5) == 1.0
    assert carried_to(track, 0.0, 0.5) == -1.0
    assert carried_to(track, 0.9, 0.5) == pytest.approx(-0.2)


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(0.1, 3.0))
def test_clock_change_alters_believed_delay_within_limits(
    before: float, after: float, longest: float
) -> None:
    change = abs(believed_delay(after, longest) - believed_delay(before, longest))
    assert change <= min(abs(after - before), longest) + 1e-12


@pytest.mark.parametrize(("rate", "longest"), [(100.0, 0.5), (20.0, 0.5), (5.0, 0.6), (1.0, 3.0)])
def test_longest_believed_delay_depends_on_rate(rate: float, longest: float) -> None:
    assert longest_delay(rate) == pytest.approx(longest)


def test_velocity_after_a_jump_is_limited_to_top_speed() -> None:
    track = seen(first_seen(0.0, 0j), 0.05, 50.0 + 0j, TAU, 0.3)
    assert track.point == 50.0
    assert abs(track.velocity) <= 0.3


STEP, LIMIT, LONGEST, TOP = 0.05, 0.15, 0.5, 10.0
NEVER = Track(-math.inf, 0j, 0j)


def driving(steps: int, link: Link, track: Track = NEVER) -> Track:
    """The track of a neighbour that drives at 1 m/s, after `steps` samples."""
    for step in range(steps):
        stamp = step * STEP - link.late
        track = arrived(track, stamp, complex(stamp), learned(stamp - track.stamp, 0.1), TOP)
    return track


@pytest.mark.parametrize(
    ("steps", "carried_over"), [(0, 0), (2, 2), (4, 4), (10, 10), (12, 8), (16, 4), (20, 0), (30, 0)]
)
def test_late_sample_on_a_link_is_extrapolated(steps: int, carried_over: int) -> None:
    """Beyond 0.5 s only in part."""
    link = Link(steps * STEP, LIMIT, LONGEST)
    track = driving(60, link)
    assert track.point == pytest.approx((59 - steps) * STEP)
    assert track.velocity == pytest.approx(1.0, abs=1e-6)
    assert carried(track, 59 * STEP, link) == pytest.approx((59 - steps + carried_over) * STEP, abs=1e-6)


def test_no_sample_is_fresh_beyond_the_limit() -> None:
    for late in (0.0, 3 * STEP):
        link = Link(late, LIMIT, LONGEST)
        track = driving(60, link)
        fresh = [is_fresh(track, (59 + silence) * STEP, link) for silence in range(6)]
        assert fresh == [True, True, True, True, False, False]


@pytest.mark.parametrize(
    ("silence", "velocity"), [(FORGETTING_SILENCE - STEP, 1.0), (FORGETTING_SILENCE + STEP, 0.0)]
)
def test_velocity_is_learned_anew_after_forgetting_silence(silence: float, velocity: float) -> None:
    track = driving(60, Link(0.0, LIMIT, LONGEST))
    later = track.stamp + silence
    track = arrived(track, later, complex(later), 1.0, TOP)
    assert track.velocity == pytest.approx(velocity, abs=1e-6)
    assert track.point == pytest.approx(later)
