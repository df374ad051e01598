"""Plan after plan beside a copy of the product with one defect, in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.campaigns.defects.copies import ROOT, copy
from tests.campaigns.defects.defect import Defect
from tests.campaigns.defects.plans import PLANS

TIMEOUT_SECONDS = 3600.0  # for all plans of one defect; what takes longer hangs
Row = dict[str, Any]  # what came of one defect, as in docs/defects.json


def tried(defect: Defect | None, numbers: Sequence[int]) -> Row:
    """Try the plans of these `numbers` on the product with `defect`, or as it is."""
    with tempfile.TemporaryDirectory(prefix="defect-") as name:
        folder = Path(name)
        copy(folder, defect)
        command = [sys.executable, "-m", "tests.campaigns.defects.inside", *map(str, numbers)]
        paths = f"{folder}{os.pathsep}{ROOT}"
        variables = {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONSAFEPATH": "1"}
        try:
            ran = subprocess.run(
                command, cwd=folder, env=os.environ | variables, timeout=TIMEOUT_SECONDS,
                capture_output=True, text=True, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as late:
            return _row(defect, _lines(late.stdout or b""), folder, {"rule": "hangs", "what": "no end"})
        failed = {"rule": "exit", "what": f"code {ran.returncode}: {ran.stderr.strip()[-300:]}"}
        return _row(defect, _lines(ran.stdout), folder, failed if ran.returncode else None)


def _row(defect: Defect | None, lines: list[Row], folder: Path, failed: Row | None) -> Row:
    imported = [Path(one["formation"]) for one in lines if "formation" in one]
    if imported and not imported[0].is_relative_to(folder):
        raise RuntimeError(f"{imported[0]} was imported, not the copy in {folder}")
    ran = [one for one in lines if "plan" in one]
    broken = [{**one, "plan": PLANS[last["plan"]].words} for last in ran[-1:] for one in last["broken"]]
    if failed is not None:
        broken = [{"time": 0.0, "robot": "", "plan": "", **failed}]
    about = {} if defect is None else {name: getattr(defect, name) for name in ("name", "file", "breaks")}
    return {**about, "found": bool(broken), "plans": len(ran), "broken": broken}


def _lines(text: str | bytes) -> list[Row]:
    words = text.decode() if isinstance(text, bytes) else text
    return [json.loads(line) for line in words.splitlines() if line.startswith("{") and line.endswith("}")]
