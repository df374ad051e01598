"""No subject is measured while Python compiles it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.bench.compiled import compile_modules


def test_a_subject_finds_its_modules_compiled_where_python_is_told_to_keep_none(tmp_path: Path) -> None:
    module = tmp_path / "package" / "inner" / "subject.py"
    module.parent.mkdir(parents=True)
    module.touch()
    compile_modules([tmp_path / "package"])
    told = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-v", "-c", "import package.inner.subject"],
        cwd=tmp_path, env=told, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert f"matches {module}" in done.stderr
