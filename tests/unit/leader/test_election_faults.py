"""A few of the random moments of `tests.campaigns.timings.elections`."""

from __future__ import annotations

import pytest

from tests.campaigns.timings.elections import SCENARIOS, judged


@pytest.mark.parametrize(
    ("scenario", "seed"),
    [
        *((scenario, seed) for scenario in SCENARIOS for seed in range(2)),
        *(
            pytest.param(scenario, seed, marks=pytest.mark.slow)
            for scenario in SCENARIOS
            for seed in range(2, 6)
        ),
        ("mixed missions", 94),  # robot reverses direction: false hold for contradictory speeds
        ("wrong clocks", 428),  # robots relay a term half a day ahead: no leader was elected
    ],
)
def test_fault_at_a_random_moment(scenario: str, seed: int) -> None:
    _, why = judged(scenario, seed)
    assert not why
