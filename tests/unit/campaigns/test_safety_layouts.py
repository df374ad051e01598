"""Layouts of posts in the safety campaign, and its verdicts."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import pytest

from formation.mission.robot import ScanSpec
from tests.campaigns.safety import posts
from tests.campaigns.safety.posts import (
    ASIDE,
    BODY,
    FAR,
    FORMED,
    GAP,
    HEAD,
    MOST,
    NEAR,
    THICK,
    THIN,
    Trial,
    layout,
    mission,
    tracks,
)

SEEDS = range(200)
FINE = Trial(0, worse=True, posts=1, nearest_post=0.1, nearest_body=0.1, error=0.5 * FORMED, deadlocks=0)


def test_layout_leaves_gaps_crosses_the_path_and_needs_a_detour() -> None:
    for found in map(layout, SEEDS):
        assert 1 <= len(found) <= MOST
        for one, other in combinations(found, 2):
            assert abs(one.at - other.at) - one.radius - other.radius >= GAP
        places = [(post.radius, post.at * HEAD.conjugate()) for post in found]
        for radius, place in places:
            assert NEAR <= place.real <= FAR
            assert min(tracks()) - ASIDE <= place.imag <= max(tracks()) + ASIDE
            assert THIN <= radius <= THICK
        assert any(abs(place.imag - track) < radius + BODY for radius, place in places for track in tracks())


def test_layout_is_reproducible_and_differs_by_seed() -> None:
    assert layout(3) == layout(3)
    assert len({tuple(layout(seed)) for seed in SEEDS}) == len(SEEDS)


def test_robots_start_clear_of_posts() -> None:
    for seed in SEEDS:
        one = mission(layout(seed), worse=True)
        starts = [one.robots[name].start.position for name in one.followers]
        for post in one.simulation.posts:
            at, radius = post.disc
            assert min(abs(start - at) for start in starts) > 1.0 + radius


def test_only_the_worse_scanner_has_noise_and_losses() -> None:
    for worse, expected in ((True, (0.1, 0.005, 0.0175)), (False, (0.0, 0.0, 0.0))):
        scanner = mission(layout(0), worse=worse).simulated_scanner.scanner(ScanSpec())
        assert (scanner.lost, scanner.noise, scanner.relative_noise) == expected


@pytest.mark.parametrize(
    ("change", "held"),
    [
        ({}, [True, True]),
        ({"nearest_post": -0.001}, [False, True]),
        ({"nearest_body": -0.001}, [False, True]),
        ({"error": FORMED}, [True, False]),
    ],
)
def test_failed_layout_breaks_its_bar_and_is_named(change: dict[str, Any], held: list[bool]) -> None:
    wrong = FINE._replace(seed=7, **change)
    found = posts.judged([FINE, wrong, FINE._replace(worse=False)])
    assert [one["held"] for one in found["bars"]] == [*held, True, True]
    assert ("seed 7" in posts.section(found)) == (not all(held))


def test_last_robot_passes_posts_before_formation_is_judged() -> None:
    one = mission(layout(0), worse=True)
    last = min((slot * HEAD.conjugate()).real for slot in one.slots())
    assert 0.2 * (posts.SECONDS - posts.LAST) + last > FAR + THICK + BODY
