"""`formation replay --verify` with recordings of real runs."""

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
from typing import Any

import pytest

from formation.deploy.recordings.verify import main
from formation.monitor.recording.reader import read
from formation.topics import CMD_VEL
from tests.support.child import PATIENCE, until
from tests.support.launched import Output, result_of, started

pytestmark = pytest.mark.processes


def verified(recording: Path, *flags: str) -> tuple[int, str, dict[str, Any]]:
    """Exit code of `formation replay FILE --verify`, its text and its JSON output."""
    out, words = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(words):
        code = main([str(recording), "--verify", "--json", *flags])
    result: dict[str, Any] = json.loads(out.getvalue())
    return code, words.getvalue(), result


def command_counts(recording: Path) -> dict[str, int]:
    """Number of recorded commands, by robot."""
    one = read(recording)
    counts = Counter(message.sample.key for message in one.messages())
    return {name: counts[CMD_VEL.key(name)] for name in one.mission.followers}


def assert_commands_reproduced(recording: Path) -> None:
    """Assert that every command of every robot is compared and is equal to the last bit."""
    code, text, result = verified(recording)
    assert code == 0, text
    assert {name: one["exact"] for name, one in result["robots"].items()} == command_counts(recording), text
    assert min(command_counts(recording).values()) > 100


@contextmanager
def replacement(line: list[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process with this command line, as a child of this one; yield it once it is ready."""
    line = line.copy()
    line[line.index("--parent") + 1] = str(os.getpid())
    with (
        tempfile.TemporaryFile() as output,
        subprocess.Popen(line, cwd=folder, stdout=output, stderr=subprocess.DEVNULL) as other,
    ):
        try:
            until(lambda: b'"event": "ready"' in os.pread(output.fileno(), 1000, 0))
            yield other
            other.send_signal(signal.SIGTERM)
            other.wait(PATIENCE)
        finally:
            other.kill()


def order(do: str, links: list[str]) -> dict[str, str]:
    """Give an order by the command line; return the mode of each robot that acknowledges it."""
    words = ["stop", "turtlebot3_pair"] if do == "stop" else ["order", "turtlebot3_pair", do]
    command = [sys.executable, "-m", "formation.deploy", *words, "--json", *links]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    acknowledged = json.loads(done.stdout)["acknowledged"]
    assert all(one["ms"] < 1000.0 for one in acknowledged)
    return {one["robot"]: one["mode"] for one in acknowledged}


def recorded_with_replaced_agent(folder: Path) -> Path:
    """The recording of a run with orders, and with an agent that was killed and replaced."""
    with started("turtlebot3_pair", "--duration", "300", "--record", "run.mcap", folder=folder) as process:
        assert process.stderr is not None
        hint = process.stderr.readline().partition("another terminal: ")[2].split()
        assert hint[:3] == ["formation", "stop", "turtlebot3_pair"]
        links = hint[3:]  # empty if the mission's own ports were free
        reported = Output(process)
        children = reported.wait(2.0)
        lines = {child.pid: child.cmdline() for child in children}
        victim, agent = next(
            (pid, line) for pid, line in lines.items() if line[3] == "formation.agent" and line[6] == "robot2"
        )
        for do, modes in (
            ("hold", {"hold"}),
            ("run", {"run", "hold"}),  # a robot runs once the leader says so
            ("stop", {"stop"}),
            ("release", {"hold"}),
            ("run", {"run", "hold"}),
        ):
            acknowledged = order(do, links)
            assert acknowledged.keys() == {"leader", "robot1", "robot2"}
            assert set(acknowledged.values()) <= modes
        reported.wait_more(4.0)
        os.kill(victim, signal.SIGKILL)
        with replacement(agent, folder):
            reported.wait_more(4.0)
        process.send_signal(signal.SIGTERM)
        reported.ended()
        result_of(process)
    return folder / "run.mcap"


def test_run_with_orders_and_replaced_agent_is_reproduced(tmp_path: Path) -> None:
    recording = recorded_with_replaced_agent(tmp_path)
    code, text, result = verified(recording)
    assert code == 0, text
    for name, one in result["robots"].items():
        assert one["exact"] == command_counts(recording)[name] - commands_without_odometry(one), text


def commands_without_odometry(robot: dict[str, Any]) -> int:
    """1 if the agent was killed after its last command and before it published the odometry used, else 0."""
    last = [one for one in robot["not_judged"] if "robot2/odom that its agent received" in one["reason"]]
    robot["not_judged"] = [one for one in robot["not_judged"] if one not in last]
    assert [one["commands"] for one in last] in ([], [1])
    return len(last)
