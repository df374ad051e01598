"""One link of a simulation: what is known of a neighbour whose samples are late or lost."""

from __future__ import annotations

import math

import pytest

from formation.control.tracker import FORGETTING_SILENCE, Track, learned
from formation.simulation.neighbours import Link, arrived, carried, is_fresh

STEP, LIMIT, LONGEST, TOP = 0.05, 0.15, 0.5, 10.0
NEVER = Track(-math.inf, 0j, 0j)


def driving(steps: int, link: Link, track: Track = NEVER) -> Track:
    """The track of a neighbour that goes at 1 m/s, after so many of its samples."""
    for step in range(steps):
        stamp = step * STEP - link.late
        track = arrived(track, stamp, complex(stamp), learned(stamp - track.stamp, 0.1), TOP)
    return track


def test_first_sample_assumes_standstill() -> None:
    assert arrived(NEVER, 3.0, 1j, 1.0, TOP) == (3.0, 1j, 0j)


def test_on_a_perfect_link_the_neighbour_is_where_it_is() -> None:
    link = Link(0.0, LIMIT, LONGEST)
    assert carried(driving(60, link), 59 * STEP, link) == pytest.approx(59 * STEP)


@pytest.mark.parametrize("steps", [2, 4, 10])
def test_late_sample_of_steady_neighbour_is_extrapolated(steps: int) -> None:
    link = Link(steps * STEP, LIMIT, LONGEST)
    track = driving(60, link)
    assert track.point == pytest.approx((59 - steps) * STEP)
    assert track.velocity == pytest.approx(1.0, abs=1e-6)
    assert carried(track, 59 * STEP, link) == pytest.approx(59 * STEP, abs=1e-6)


@pytest.mark.parametrize(("steps", "carried_over"), [(12, 8), (16, 4), (20, 0), (30, 0)])
def test_too_old_sample_is_extrapolated_only_in_part(steps: int, carried_over: int) -> None:
    link = Link(steps * STEP, LIMIT, LONGEST)
    there = (59 - steps + carried_over) * STEP
    assert carried(driving(60, link), 59 * STEP, link) == pytest.approx(there, abs=1e-6)


def test_no_sample_is_fresh_beyond_the_limit() -> None:
    for late in (0.0, 3 * STEP):
        link = Link(late, LIMIT, LONGEST)
        track = driving(60, link)
        fresh = [is_fresh(track, (59 + silence) * STEP, link) for silence in range(6)]
        assert fresh == [True, True, True, True, False, False]


@pytest.mark.parametrize(
    ("silence", "velocity"), [(FORGETTING_SILENCE - STEP, 1.0), (FORGETTING_SILENCE + STEP, 0.0)]
)
def test_after_a_long_silence_the_velocity_is_learned_anew(silence: float, velocity: float) -> None:
    track = driving(60, Link(0.0, LIMIT, LONGEST))
    later = track.stamp + silence
    track = arrived(track, later, complex(later), 1.0, TOP)
    assert track.velocity == pytest.approx(velocity, abs=1e-6)
    assert track.point == pytest.approx(later)
