"""Orders that are lost, late, doubled and repeated set no robot going: some of the campaign's timings."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from tests.campaigns.timings.orders import SCENARIOS

Scenario = Callable[[random.Random], None]


@pytest.mark.slow
@pytest.mark.parametrize("part", range(3))
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.__name__)
def test_no_order_is_lost_and_none_starts_motion(scenario: Scenario, part: int) -> None:
    for seed in range(10 * part, 10 * part + 10):
        scenario(random.Random(f"{scenario.__name__} {seed}"))
