"""What the product imports is what pyproject.toml names, each in the extra that brings it."""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from formation.deploy.env import ROOT
from formation.transport.runtime.command_line import EXTRAS

OWN = {"formation", "agent", "leader", "monitor", "deploy"}
ON_A_ROBOT = {"numpy", "pydantic", "pydantic_core", "zenoh"}
BY_PYTEST = {"pytest"}
"""Imported by the plugin alone, which only pytest loads."""
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
def test_an_imported_package_is_a_declared_dependency(package: str) -> None:
    extra = EXTRAS.get(package)
    lines = PROJECT["dependencies"] if extra is None else PROJECT["optional-dependencies"][extra]
    declared = {canonicalize_name(Requirement(line).name) for line in lines}
    brought_by = {canonicalize_name(name) for name in packages_distributions()[package]}
    assert declared & brought_by


def test_a_desk_has_every_extra_but_those_for_special_tools() -> None:
    (desk,) = map(Requirement, PROJECT["optional-dependencies"]["desk"])
    assert desk.extras == PROJECT["optional-dependencies"].keys() - {"desk", "foxglove", "physics", "dask"}
