"""README, guide, reference and pyproject.toml agree with the code."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pydantic import BaseModel

from formation.agent.simulated.faults import Size
from formation.deploy.cli import COMMANDS
from formation.deploy.env import ROOT
from formation.deploy.rehearsal.faults import KINDS, KINDS_AND_SIZES
from formation.mission.file import shipped
from formation.mission.model import Mission
from formation.monitor.metrics.events import STATES
from formation.transport.runtime.command_line import EXTRAS
from tests.support.reference import mission_keys, topics
from tests.support.reference.__main__ import PAGES as GENERATED
from tests.support.reference.__main__ import REGENERATE
from tests.support.reference.mission_keys import TABLES

README = (ROOT / "README.md").read_text(encoding="utf-8")
REFERENCE = ROOT / "docs" / "reference"
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
PAGES = [
    ROOT / "README.md",
    ROOT / "deploy" / "README.md",
    ROOT / "docs" / "README.md",
    ROOT / "docs" / "theory" / "README.md",
    ROOT / "docs" / "reference" / "topics.md",
    *GUIDE,
]
LINKED = sorted({*PAGES, *REFERENCE.glob("*.md"), ROOT / "docs" / "glossary.md"})


def test_topic_table_of_docs_equals_code() -> None:
    page = (ROOT / "docs" / "reference" / "topics.md").read_text(encoding="utf-8")
    table = re.search(r"<!-- topics: begin -->\n(.*)<!-- topics: end -->", page, re.DOTALL)
    assert table is not None
    assert table[1] == topics.table()


@pytest.mark.parametrize("page", LINKED, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_linked_file_and_heading_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)]*)\)|<img src=\"([^\"]+)", text)
    for path, _, anchor in ((link or image).partition("#") for link, image in links):
        target = page.parent / path if path else page
        assert target.exists(), path
        if anchor:
            assert anchor in anchors(target), f"{path}#{anchor}"


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_page_of_the_guide_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert not [page.name for page in GUIDE if f"(guide/{page.name})" not in index]


def test_pages_name_existing_commands_and_readme_names_missions() -> None:
    commands = set(re.findall(r"`formation ([a-z]+)", README))
    assert {"run", "check", "simulate", "order"} <= commands
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = "\n".join(re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
        named = re.findall(r"`formation ([a-z]+)", text)
        named += re.findall(r"^formation ([a-z]+)", blocks, re.MULTILINE)
        assert set(named) <= set(COMMANDS), page.name
    for name in shipped():
        assert f"`{name}`" in README


def test_guide_describes_every_fault_of_a_rehearsal() -> None:
    page = (ROOT / "docs" / "guide" / "rehearsal.md").read_text(encoding="utf-8")
    described = re.findall(r"^\| `(\w+)` \| (robot|any) \| (.*) \| (.*) \|$", page, re.MULTILINE)
    kinds = {
        name: ("robot" if kind.robots_only else "any", kind.what, sizes(KINDS_AND_SIZES[name]))
        for name, kind in KINDS.items()
    }
    assert {name: about for name, *about in described} == {name: [*about] for name, about in kinds.items()}


def sizes(legal: Size | None) -> str:
    """What the guide says of a fault's SIZE: where none is given, least and greatest."""
    return "" if legal is None else f"{legal.usual:g}; {legal.lowest:g} to {legal.highest:g}"


def test_router_line_of_guide_exports_no_variable() -> None:
    guide = (ROOT / "docs" / "guide" / "real-robots.md").read_text(encoding="utf-8")
    (line,) = [line for line in guide.splitlines() if "ZENOH_CONFIG_OVERRIDE=" in line]
    assert line.endswith(" ros2 run rmw_zenoh_cpp rmw_zenohd")
    assert not line.startswith("export")


def test_ci_runs_test_command_of_readme() -> None:
    (line,) = re.findall(r"^python3 deploy/env\.py pytest$", README, re.MULTILINE)
    assert line in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()


COMPUTED = {
    "kind": {kind for kind, _ in STATES.values()},
    "self._availability.state": {"unavailable", "follows"},
    "state": {"clear", "avoiding", "blocked"},
}
"""Kinds of events that the code computes, by their expression."""
DIMENSIONLESS = {"domain", "drift", "beams", "relative_noise", "lost", "scale"}


@pytest.mark.parametrize("name", GENERATED)
def test_generated_page_is_up_to_date(name: str) -> None:
    committed = (REFERENCE / name).read_text(encoding="utf-8")
    assert committed == GENERATED[name](), f"docs/reference/{name} is out of date: run `{REGENERATE}`"


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


OWN = {"formation", "agent", "leader", "monitor", "deploy"}
ON_A_ROBOT = {"numpy", "pydantic", "pydantic_core", "zenoh"}
BY_PYTEST = {"pytest"}
"""Imported only by the plugin that pytest loads."""
DISTRIBUTIONS = packages_distributions()
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def imported(module: ast.Module) -> Iterator[str]:
    """Packages that are imported anywhere in a module."""
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            yield from (one.name.partition(".")[0] for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.partition(".")[0]


def test_every_imported_package_is_known() -> None:
    found: set[str] = set()
    for path in (path for name in OWN for path in (ROOT / name).rglob("*.py")):
        found.update(imported(ast.parse(path.read_text(encoding="utf-8"))))
    assert found - OWN - BY_PYTEST - sys.stdlib_module_names == ON_A_ROBOT | EXTRAS.keys()


@pytest.mark.parametrize("package", sorted(ON_A_ROBOT | EXTRAS.keys()))
def test_imported_package_is_a_declared_dependency(package: str) -> None:
    extra = EXTRAS.get(package)
    lines = PROJECT["dependencies"] if extra is None else PROJECT["optional-dependencies"][extra]
    declared = {canonicalize_name(Requirement(line).name) for line in lines}
    brought_by = {canonicalize_name(name) for name in DISTRIBUTIONS[package]}
    assert declared & brought_by


def test_desk_extra_includes_all_but_special_extras() -> None:
    (desk,) = map(Requirement, PROJECT["optional-dependencies"]["desk"])
    assert desk.extras == PROJECT["optional-dependencies"].keys() - {"desk", "foxglove", "physics", "dask"}
