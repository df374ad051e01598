"""`formation` as a process, for as long as a test looks at it."""

from __future__ import annotations

import io
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import psutil

from formation.deploy.recordings import verify
from formation.monitor.recording.reader import read
from formation.topics import CMD_VEL
from tests.support.child import PATIENCE

LONGEST_START = 120.0
"""How long all processes of a run may take to start on a machine with much to do [s]."""


@contextmanager
def command(*arguments: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """`formation ARGUMENTS`, killed at the end if it still lives."""
    with subprocess.Popen(
        [sys.executable, "-m", "formation.deploy", *arguments],
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
        if (seen := run_for(text)) is not None and seen >= seconds:
            return psutil.Process(process.pid).children(recursive=True)
    raise AssertionError(f"it ended with exit code {process.wait()} before {seconds} s")


def wait_until_formed(process: subprocess.Popen[str], bound: float) -> float:
    """Read what it says until the error is under `bound` [m] three times in a row, two seconds apart.

    Returns how long it had run when it said so for the first time [s]. A verdict that is asked for then does
    not depend on what the machine did at one moment chosen beforehand: a robot without messages meanwhile
    holds, and has to catch up.
    """
    assert process.stderr is not None
    first, below = math.inf, 0
    for text in process.stderr:
        if (seen := run_for(text)) is not None:
            is_below = error_in(text) < bound
            first, below = min(first, seen if is_below else math.inf), below + 1 if is_below else 0
        if below == 3:
            return first
    raise AssertionError(f"it ended with exit code {process.wait()} before the formation stood")


def error_in(line: str) -> float:
    """The formation error of a line that tells how long it has run [m]; infinite if that is not known."""
    found = re.search(r"error <?([0-9.]+) (mm|cm|m)\b", line)
    return float(found[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[found[2]] if found else math.inf


def run_for(line: str) -> float | None:
    """How long it had run when it said so [s]; None for a line that tells of something else."""
    words = line.split()
    return float(words[0]) if words[1:2] == ["of"] and "error" in words else None


class Output:
    """What a run says while the test does something else, read as it comes: nothing of it is old.

    For one of which no test reads stderr otherwise until it `ended`.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._elapsed = 0.0
        self._said = time.monotonic()  # when it said something last [s]
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait(self, seconds: float) -> list[psutil.Process]:
        """Wait until it says that it has run for so long; its children then."""
        while self._elapsed < seconds:
            assert self._reader.is_alive(), f"it ended with exit code {self._process.wait(PATIENCE)}"
            patience = PATIENCE if self._elapsed else LONGEST_START
            silent = time.monotonic() - self._said
            assert silent < patience, f"after {self._elapsed} s it said nothing any more"
            time.sleep(0.01)
        return psutil.Process(self._process.pid).children(recursive=True)

    def wait_more(self, seconds: float) -> None:
        """Wait until it has run for so long from now on."""
        self.wait(self._elapsed + 0.01)  # the newest line may be two seconds old
        self.wait(self._elapsed + seconds)

    def ended(self) -> None:
        self._reader.join(PATIENCE)
        assert not self._reader.is_alive()

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._said = time.monotonic()
            self._elapsed = run_for(line) or self._elapsed


def formed(process: subprocess.Popen[str], bound: float, within: float) -> dict[str, Any]:
    """The result of a run whose error comes under `bound` [m] `within` a time [s]; ended when it stays so."""
    assert wait_until_formed(process, bound) <= within
    process.send_signal(signal.SIGINT)
    return result_of(process)


def result_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, _ = process.communicate(timeout=90.0)
    result = json.loads(out.splitlines()[-1])
    assert isinstance(result, dict)
    return result


def assert_commands_reproduced(recording: Path) -> None:
    """Assert that `replay --verify` compares every command of every robot, and finds it equal to the bit."""
    out, words = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(words):
        code = verify.main([str(recording), "--verify", "--json"])
    one = read(recording)
    counts = Counter(message.sample.key for message in one.messages())
    commands = {name: counts[CMD_VEL.key(name)] for name in one.mission.followers}
    exact = {name: found["exact"] for name, found in json.loads(out.getvalue())["robots"].items()}
    assert (code, exact) == (0, commands), words.getvalue()
    assert min(commands.values()) > 100
