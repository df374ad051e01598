"""The pages of docs/reference are true: generated ones are up to date, the others name what the code has."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from formation.mission.model import Mission
from formation.monitor.metrics.events import STATES
from tests.support.reference import mission_keys
from tests.support.reference.__main__ import PAGES, REGENERATE
from tests.support.reference.mission_keys import TABLES

ROOT = Path(__file__).parents[3]
REFERENCE = ROOT / "docs" / "reference"
COMPUTED = {
    "kind": {kind for kind, _ in STATES.values()},
    "self._availability.state": {"unavailable", "follows"},
    "state": {"clear", "avoiding", "blocked"},
}
"""Kinds of events that stand as expressions in the code, by that expression."""
DIMENSIONLESS = {"domain", "drift", "beams", "relative_noise", "lost"}


@pytest.mark.parametrize("name", PAGES)
def test_generated_page_is_up_to_date(name: str) -> None:
    committed = (REFERENCE / name).read_text(encoding="utf-8")
    assert committed == PAGES[name](), f"docs/reference/{name} is out of date: run `{REGENERATE}`"


def test_every_table_of_the_mission_is_described() -> None:
    known = {cls.__name__ for cls in TABLES.values()}
    assert set(Mission.model_json_schema()["$defs"]) | {"Mission"} == known


@pytest.mark.parametrize("cls", TABLES.values())
def test_every_mission_key_has_meaning_and_unit(cls: type[BaseModel]) -> None:
    for key, legal, _, unit, meaning in mission_keys.rows(cls):
        name = key.strip("`")
        assert meaning, f"{cls.__name__}.{name} has no docstring"
        if legal.startswith(("number", "whole number")) and name not in DIMENSIONLESS:
            assert unit, f"{cls.__name__}.{name}: its docstring must end with the unit, such as [m]"


def test_every_event_kind_is_described() -> None:
    page = (REFERENCE / "events.md").read_text(encoding="utf-8")
    described = re.findall(r"^\| `(\w+)` \| (?:information|warning|error|as in the text)", page, re.MULTILINE)
    assert len(described) == len(set(described))
    assert set(described) == set(event_kinds()), "docs/reference/events.md: one row for each kind of event"


def event_kinds() -> Iterator[str]:
    """The fourth argument of every `Event` that the monitor makes."""
    for path in (ROOT / "monitor").rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call) or ast.unparse(call.func) != "Event" or len(call.args) < 4:
                continue
            kind = call.args[3]
            if isinstance(kind, ast.Constant):
                yield str(kind.value)
            elif ast.unparse(kind) != "entry.kind":  # of an event that is read
                yield from COMPUTED[ast.unparse(kind)]


def test_links_of_the_pages_exist() -> None:
    for page in (*REFERENCE.glob("*.md"), ROOT / "docs" / "glossary.md"):
        for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
