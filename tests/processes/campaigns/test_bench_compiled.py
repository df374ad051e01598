"""No subject is measured while Python compiles it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.campaigns.bench.compiled import compile_modules


def test_compiled_modules_are_used_despite_disabled_bytecode_writing(tmp_path: Path) -> None:
    module = tmp_path / "package" / "inner" / "subject.py"
    module.parent.mkdir(parents=True)
    module.touch()
    compile_modules([tmp_path / "package"])
    reported = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-v", "-c", "import package.inner.subject"],
        cwd=tmp_path, env=reported, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert f"matches {module}" in done.stderr
