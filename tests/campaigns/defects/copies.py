"""Copies of the product, each with one defect."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.campaigns.defects.defect import Defect, changed

ROOT = Path(__file__).parents[3]
PACKAGES = ("agent", "leader", "monitor", "deploy", "formation")


def copy(folder: Path, defect: Defect | None) -> None:
    """Copy the product's packages to `folder`, with `defect`. Raises ValueError if that does not fit."""
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, folder / package, symlinks=True, ignore=shutil.ignore_patterns("__pycache__")
        )
    if defect is not None:
        (folder / defect.file).write_text(changed(defect, ROOT), encoding="utf-8")
