"""A hundred robots at a moderate rate; tests/campaigns/bench/bench_monitor.py has higher ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.campaigns.bench.bench_monitor import ROBOTS, TOPICS, one_run

pytestmark = pytest.mark.processes
RATE, SECONDS, LINKS = 5.0, 4.0, 5


def test_hundred_robots_are_recorded_completely_with_open_page(
    tmp_path: Path,
) -> None:
    run = one_run(RATE, SECONDS, tmp_path, LINKS, waits=True)
    assert run["sent"] >= ROBOTS * RATE * TOPICS * SECONDS
    assert (run["lost"], run["overflowed"], run["rejected"]) == (0.0, 0.0, 0.0)
    assert run["received"] == run["sent"]
    assert run["page_mean"] > 2.0
