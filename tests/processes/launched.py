"""`formation` as a process, for as long as a test looks at it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import psutil


@contextmanager
def command(*arguments: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """`formation ARGUMENTS`, killed at the end if it still lives."""
    with subprocess.Popen(
        [sys.executable, "-m", "deploy", *arguments],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def started(*arguments: str, folder: Path) -> AbstractContextManager[subprocess.Popen[str]]:
    """`formation run ARGUMENTS --json` in a session of its own."""
    return command("run", *arguments, "--json", folder=folder)


def wait_until_running(process: subprocess.Popen[str], seconds: float) -> list[psutil.Process]:
    """Read what it says until it has run for so long; its children then."""
    assert process.stderr is not None
    for text in process.stderr:
        words = text.split()
        if words[1:2] == ["of"] and "error" in words and float(words[0]) >= seconds:
            return psutil.Process(process.pid).children(recursive=True)
    raise AssertionError(f"it ended with exit code {process.wait()} before {seconds} s")


def result_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, _ = process.communicate(timeout=90.0)
    result = json.loads(out.splitlines()[-1])
    assert isinstance(result, dict)
    return result
