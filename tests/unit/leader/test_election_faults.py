"""A few of the random moments of `tests.campaigns.timings.elections`."""

from __future__ import annotations

import pytest

from tests.campaigns.timings.elections import SCENARIOS, judged
from tests.support.examples import slow


@pytest.mark.parametrize(
    ("scenario", "seed"),
    [
        *((scenario, 0) for scenario in SCENARIOS),
        *slow(*((scenario, seed) for scenario in SCENARIOS for seed in range(1, 6))),
        ("mixed missions", 94),  # robot reverses direction: false hold for contradictory speeds
        ("wrong clocks", 428),  # robots relay a term half a day ahead: no leader was elected
    ],
)
def test_fault_at_a_random_moment(scenario: str, seed: int) -> None:
    _, why = judged(scenario, seed)
    assert not why
