"""A few of the random moments of `tests.leader.campaign`."""

from __future__ import annotations

import pytest

from tests.leader.campaign import SCENARIOS, judged


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("seed", range(6))
def test_fault_at_a_random_moment(scenario: str, seed: int) -> None:
    _, why = judged(scenario, seed)
    assert not why
