"""Pages in docs/ equal the pages that campaigns generate from the committed figures."""

from __future__ import annotations

import json
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib.font_manager  # noqa: F401 - its first import runs fc-list, which a unit test may not
import pytest

from tests.campaigns.bench.__main__ import document
from tests.campaigns.bench.yardstick_page import page
from tests.campaigns.document import DOCS


def committed(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def figures(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("campaign", ["reliability", "safety"])
def test_campaign_page_equals_page_generated_from_figures(campaign: str, tmp_path: Path) -> None:
    shutil.copy(DOCS / f"{campaign}.json", tmp_path)
    import_module(f"tests.campaigns.{campaign}.__main__").write({}, tmp_path)
    assert (tmp_path / f"{campaign}.md").read_text(encoding="utf-8") == committed(campaign)


def test_benchmark_page_equals_page_generated_from_figures() -> None:
    assert document(figures("benchmarks")) == committed("benchmarks")


def test_yardstick_page_equals_page_generated_from_figures() -> None:
    assert page(figures("yardstick")["yardstick"]) == committed("yardstick")
