"""Deliberate defects fit the source, and their plans fit the missions."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from formation.deploy.rehearsal.faults import KINDS, parse
from formation.mission.file import load
from tests.campaigns.defects.catalogue.all import DEFECTS, EVERY
from tests.campaigns.defects.copies import ROOT
from tests.campaigns.defects.defect import Defect, changed
from tests.campaigns.defects.page import text
from tests.campaigns.defects.plan import Plan
from tests.campaigns.defects.plans import GROUPS, PLANS, ordered
from tests.campaigns.defects.reasons import REASONS


@pytest.mark.parametrize("defect", DEFECTS.values(), ids=list(DEFECTS))
def test_defect_fits_source_once_and_parses(defect: Defect) -> None:
    assert changed(defect, ROOT)
    assert defect.first
    assert set(defect.first) <= set(GROUPS)


def test_defect_names_are_distinct_and_at_most_100() -> None:
    assert len(DEFECTS) == len(EVERY) <= 100
    assert set(REASONS) <= set(DEFECTS)


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("no such text", "", "has 0 times"),
        ("import", "", "times"),
        ("import math\n", "import (\n", "invalid syntax"),
    ],
)
def test_defect_that_does_not_fit_is_refused(before: str, after: str, why: str) -> None:
    defect = Defect("one", "formation/control/plane.py", before, after, "nothing", ())
    with pytest.raises(ValueError, match=why):
        changed(defect, ROOT)


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.words)
def test_plan_fits_its_mission(plan: Plan) -> None:
    mission = load(plan.source)
    assert all(parse(fault, mission) for fault in plan.faults)
    assert set(plan.kinds) <= {"all", *KINDS}
    assert list(plan.told) == sorted(plan.told, key=lambda one: one.at)


@pytest.mark.parametrize("first", [(), ("signed",), ("orders", "quiet")])
def test_ordered_keeps_all_plans_and_puts_first_group_first(first: Sequence[str]) -> None:
    numbers = ordered(first)
    assert sorted(numbers) == list(range(len(PLANS)))
    assert not first or PLANS[numbers[0]] == GROUPS[first[0]][0]


def test_page_lists_detected_and_undetected_defects() -> None:
    row = {"name": "half-plane-inverted", "file": "", "breaks": "robots meet", "plans": 3}
    broken = {"rule": "touch", "time": 1.0, "robot": "robot1", "what": "overlap", "plan": "swap --seed 0"}
    found = {
        "date": "today", "commit": "abc", "machine": "one", "took": 60.0, "plans": 9,
        "defects": [
            {**row, "found": True, "broken": [broken]},
            {**row, "name": "brake-late", "found": False, "broken": []},
        ],
    }  # fmt: skip
    page = text(found)
    assert "1 of 2" in page
    assert "| `half-plane-inverted` | robots meet | touch | 3 | `swap --seed 0` |" in page
    assert "`brake-late` | robots meet |" in page
