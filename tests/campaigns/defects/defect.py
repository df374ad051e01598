"""A deliberate defect: one place of the product's source, what replaces it, and what that breaks."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import NamedTuple


class Defect(NamedTuple):
    """One change of one file."""

    name: str
    file: str  # from the root of this repository
    before: str  # what the file contains exactly once
    after: str  # what replaces it
    breaks: str  # what a user loses
    first: tuple[str, ...]  # groups of plans that it meets before the others


def changed(defect: Defect, root: Path) -> str:
    """The file of `defect` under `root` with its change. Raises ValueError if that does not fit, or parse."""
    text = (root / defect.file).read_text(encoding="utf-8")
    if (times := text.count(defect.before)) != 1:
        raise ValueError(f"{defect.name}: {defect.file} has {times} times: {defect.before}")
    if defect.before == defect.after:
        raise ValueError(f"{defect.name}: changes nothing")
    new = text.replace(defect.before, defect.after)
    try:
        ast.parse(new)
    except SyntaxError as error:
        raise ValueError(f"{defect.name}: {error}") from None
    return new
