"""Recordings of real runs, lived through again by today's agents: bar 5 of watching."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from formation.deploy.recordings.verify import main
from formation.monitor.recording.reader import read
from formation.topics import CMD_VEL
from tests.support.child import PATIENCE, until
from tests.support.launched import Output, result_of, started

pytestmark = pytest.mark.processes


def verified(recording: Path, *flags: str) -> tuple[int, str, dict[str, Any]]:
    """Exit code of `formation replay FILE --verify`, what people read, and what programs do."""
    out, words = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(words):
        code = main([str(recording), "--verify", "--json", *flags])
    result: dict[str, Any] = json.loads(out.getvalue())
    return code, words.getvalue(), result


def commands(recording: Path) -> dict[str, int]:
    """How many of each robot are in a recording."""
    one = read(recording)
    counts = Counter(message.sample.key for message in one.messages())
    return {name: counts[CMD_VEL.key(name)] for name in one.mission.followers}


def recorded(folder: Path, *arguments: str) -> Path:
    """The recording of a short run."""
    with started(*arguments, "--duration", "8", "--record", "run.mcap", folder=folder) as process:
        result_of(process)
    return folder / "run.mcap"


def whole(recording: Path) -> None:
    """Every command of every robot has been compared, and is the same to the last bit."""
    code, text, result = verified(recording)
    assert code == 0, text
    assert {name: one["exact"] for name, one in result["robots"].items()} == commands(recording), text
    assert min(commands(recording).values()) > 100


@pytest.mark.parametrize("mission", ["six_robots", "turtlebot3_pair"])
def test_every_command_of_real_run_is_reproduced_exactly(tmp_path: Path, mission: str) -> None:
    whole(recorded(tmp_path, mission))


class Eventful(NamedTuple):
    """A run with orders, and an agent that was killed and replaced; recorded whole, and from later on."""

    whole: Path
    late: Path


@contextmanager
def like(line: list[str], folder: Path, *also: str, **instead: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process with such a command line, with some flags set differently, that is ready."""
    line = line.copy()
    for flag, value in {"parent": str(os.getpid()), **instead}.items():
        line[line.index(f"--{flag}") + 1] = value
    with (
        tempfile.TemporaryFile() as output,
        subprocess.Popen([*line, *also], cwd=folder, stdout=output, stderr=subprocess.DEVNULL) as other,
    ):
        try:
            until(lambda: b'"event": "ready"' in os.pread(output.fileno(), 1000, 0))
            yield other
            other.send_signal(signal.SIGTERM)
            other.wait(PATIENCE)
        finally:
            other.kill()


@pytest.fixture(scope="module")
def eventful(tmp_path_factory: pytest.TempPathFactory) -> Eventful:
    folder = tmp_path_factory.mktemp("eventful")
    whole, late = folder / "run.mcap", folder / "late.mcap"
    with started("turtlebot3_pair", "--duration", "300", "--record", "run.mcap", folder=folder) as process:
        assert process.stderr is not None
        links = process.stderr.readline().partition("another terminal: ")[2].split()[3:]
        reported = Output(process)
        children = reported.wait(2.0)
        lines = {child.pid: child.cmdline() for child in children}
        monitor = next(line for line in lines.values() if line[3] == "formation.monitor")
        victim, agent = next(
            (pid, line) for pid, line in lines.items() if line[3] == "formation.agent" and line[6] == "robot2"
        )
        with like(monitor, folder, "--no-page", record=str(late)):
            for do in ("hold", "run", "stop", "release", "run"):
                command = [sys.executable, "-m", "formation.deploy", "order", "turtlebot3_pair", do, *links]
                subprocess.run(command, check=True, timeout=60.0, stdout=subprocess.DEVNULL)
            reported.wait_more(8.0)
        os.kill(victim, signal.SIGKILL)  # with one monitor left: an agent waits for one, not for both
        with like(agent, folder):
            reported.wait_more(4.0)
        process.send_signal(signal.SIGTERM)
        reported.ended()
        result_of(process)
    return Eventful(whole, late)


def test_requests_and_replaced_agent_are_reproduced(
    eventful: Eventful,
) -> None:
    code, text, result = verified(eventful.whole)
    assert code == 0, text
    for name, one in result["robots"].items():
        assert one["exact"] == commands(eventful.whole)[name] - cut_short(one), text


def cut_short(robot: dict[str, Any]) -> int:
    """One if an agent was killed when it had said its last command, and not yet what odometry led to it."""
    last = [one for one in robot["not_judged"] if "robot2/odom that its agent heard" in one["reason"]]
    robot["not_judged"] = [one for one in robot["not_judged"] if one not in last]
    assert [one["commands"] for one in last] in ([], [1])
    return len(last)


def test_late_recording_is_judged_from_next_state(eventful: Eventful) -> None:
    code, text, result = verified(eventful.late)
    assert code == 0, text
    for name, one in result["robots"].items():
        assert one["exact"] == one["compared"] > 50, text  # a memory comes every 5 s, and 8 s are recorded
        cut = cut_short(one)
        (stretch,) = one["not_judged"]
        assert stretch["commands"] == commands(eventful.late)[name] - one["compared"] - cut
        assert "beginning is not in the recording" in stretch["reason"]
        assert stretch["until"] < 7.0
