"""Deliberate defects fit the source, and their plans fit the missions."""

from __future__ import annotations

import pytest

from formation.deploy.rehearsal.faults import KINDS, parse
from formation.mission.file import load
from tests.campaigns.defects.catalogue.all import DEFECTS, EVERY
from tests.campaigns.defects.copies import ROOT
from tests.campaigns.defects.defect import Defect, changed
from tests.campaigns.defects.inside import run
from tests.campaigns.defects.plan import Plan
from tests.campaigns.defects.plans import GROUPS, PLANS
from tests.campaigns.defects.reasons import REASONS


@pytest.mark.parametrize("defect", DEFECTS.values(), ids=list(DEFECTS))
def test_defect_fits_source_once_and_parses(defect: Defect) -> None:
    assert changed(defect, ROOT)
    assert defect.first
    assert set(defect.first) <= set(GROUPS)


def test_defect_names_are_distinct_and_at_most_100() -> None:
    assert len(DEFECTS) == len(EVERY) <= 100
    assert set(REASONS) <= set(DEFECTS)


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.words)
def test_plan_fits_its_mission(plan: Plan) -> None:
    mission = load(plan.source)
    assert all(parse(fault, mission) for fault in plan.faults)
    assert set(plan.kinds) <= {"all", *KINDS}
    assert list(plan.told) == sorted(plan.told, key=lambda one: one.at)


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_no_plan_breaks_a_rule_without_a_defect(group: str) -> None:
    assert {plan.words: broken for plan in GROUPS[group] if (broken := run(plan))} == {}
