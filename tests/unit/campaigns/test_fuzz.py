"""A few seeds of each campaign of `python -m tests.campaigns.fuzz`, without a limit of time."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.campaigns.fuzz import __main__ as campaigns
from tests.campaigns.fuzz import trying

SEEDS = {"recordings": range(1, 25), "missions": range(100, 140), "state": range(300, 340)}
"""Includes inputs that once raised an error."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", campaigns.KINDS)
def test_damaged_input_raises_nothing(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trying, "MAX_SECONDS", 0.0)  # no limit
    found = [one.finding for one in campaigns.KINDS[kind](tmp_path, SEEDS[kind]) if one.finding is not None]
    assert found == []
