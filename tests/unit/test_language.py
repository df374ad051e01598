"""Docstrings, messages and names of tests keep to plain English (docs/glossary.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("agent", "deploy", "formation", "leader", "monitor")
RIDDLES = re.compile(r"\b(who|whom|whose|whoever|nobody|somebody|anybody|everybody)\b", re.IGNORECASE)
"""A robot is *the robot*, and a process is named."""
MAX_WORDS_OF_TEST_NAME = 11
RETIRED = frozenset(
    {
        "asked", "echoes", "evade", "evades", "evading", "guard", "hear", "heard", "hearing", "hears",
        "keeping", "legacy", "making", "manners", "mind", "minded", "minding", "minds", "odometer",
        "outlet", "outlets", "overhead", "promise", "recall", "reign", "reigns", "remember", "rides",
        "riding", "said", "seam", "seams", "shelf", "sighting", "somebody", "survival", "told",
        "voice", "voices", "yields",
    }
)  # fmt: skip
"""Words that docs/glossary.md has replaced."""
GUARDED = Path("monitor", "web")
"""Here a guard is what protects the live page from requests of other pages."""


@cache
def sources(folder: str) -> list[tuple[Path, ast.Module]]:
    """Files of a top-level folder, without links to other folders, with their syntax trees."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return [(path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))) for path in paths]


def strings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every string: docstrings and messages."""
    for node in ast.walk(tree):
        match node:
            case ast.Constant(value=str() as text):
                yield node.lineno, text


def test_docstrings_and_messages_name_robots_and_processes() -> None:
    riddles = [
        f"{path}:{line}: {found[0]}"
        for package in PACKAGES
        for path, tree in sources(package)
        for line, text in strings(tree)
        if (found := RIDDLES.search(text))
    ]
    assert riddles == []


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every string that stands alone."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str() as text)):
                yield node.lineno, text


@pytest.mark.slow
def test_docstrings_of_tests_name_robots_and_processes() -> None:
    riddles = [
        f"{path}:{line}: {found[0]}"
        for folder in ("unit", "processes", "field", "support")
        for path, tree in sources(f"tests/{folder}")
        for line, text in docstrings(tree)
        for found in RIDDLES.finditer(text)
        if found[0].lower() != "whose"
    ]
    assert riddles == []


def identifiers(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of every variable, attribute, argument, function and class."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.FunctionDef(name=name):
                yield node.lineno, name
            case ast.ClassDef(name=name) | ast.arg(arg=name):
                yield node.lineno, name


def words(identifier: str) -> set[str]:
    """The words of a name in any case: `max_speed`, `MaxSpeed`, `MAX_SPEED`."""
    return {one.lower() for one in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", identifier)}


def test_identifiers_have_no_retired_words() -> None:
    found = [
        f"{path}:{line}: {name}"
        for package in PACKAGES
        for path, tree in sources(package)
        for line, name in identifiers(tree)
        if words(name) & (RETIRED - {"guard"} if path.is_relative_to(GUARDED) else RETIRED)
    ]
    assert found == []


def test_names_of_tests_are_short() -> None:
    found = [
        f"{path}: {name}"
        for path in (ROOT / "tests").rglob("*.py")
        for name in re.findall(r"^ *def test_(\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
        if len(name.split("_")) > MAX_WORDS_OF_TEST_NAME
    ]
    assert found == []
