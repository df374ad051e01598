"""`formation watch` for real: beside a run and its monitor, several at once, and with nobody there."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import pytest

from formation.deploy.watch import no_answer_message
from formation.mission.file import load
from tests.support.child import PATIENCE, free_endpoint
from tests.support.launched import command

pytestmark = pytest.mark.processes
SIX = load("six_robots")


@contextmanager
def running(folder: Path) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """Six robots that run, and the flags that lead to them: their ports may be others than usual."""
    arguments = ("run", "six_robots", "--duration", "300", "--no-page", "--json", "--record", "run.mcap")
    with command(*arguments, folder=folder) as process:
        assert process.stderr is not None
        flags: list[str] = []
        for line in process.stderr:
            if "formation stop" in line:
                flags = re.findall(r"-e|tcp/\S+", line)
            if "6 run" in line:
                yield process, flags
                return
    raise AssertionError("they did not come to run")


def watched(*flags: str, folder: Path) -> subprocess.CompletedProcess[str]:
    with command("watch", "six_robots", *flags, folder=folder) as process:
        out, err = process.communicate(timeout=PATIENCE)
    return subprocess.CompletedProcess([], process.returncode, out, err)


def lines_of_json(stream: IO[str]) -> Iterator[dict[str, Any]]:
    for line in stream:
        yield json.loads(line)


def formed(seen: dict[str, Any]) -> bool:
    """Whether all follow: a robot that set out late is unavailable until it is near its slot."""
    error = seen["formation_error"]
    return bool(seen["all_run"]) and error is not None and error < 0.04


def looks(*flags: str, folder: Path) -> Iterator[subprocess.CompletedProcess[str]]:
    """Pictures, one after the other.

    In one of them somebody may hold, who heard nothing while the machine stood still.
    """
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        yield watched("--once", *flags, folder=folder)
    raise AssertionError("they never ran all")


def all_run_in_table(look: subprocess.CompletedProcess[str]) -> bool:
    """Whether they do in a table, whose exit code says the same."""
    title, _, *rest = look.stdout.splitlines()
    rows = [line.split() for line in rest[: len(SIX.names)]]
    assert (title, [row[0] for row in rows]) == ("six-robots, field law", list(SIX.names)), look.stderr
    states = {row[1] if row[1] != "(leader)" else row[2] for row in rows}
    assert look.returncode in ({1} if "hold" in states else {0, 1})
    return look.returncode == 0 and states == {"run"}


def all_run_in_json(look: subprocess.CompletedProcess[str]) -> bool:
    """Whether they do as programs are told, which goes for the exit code, too."""
    seen = json.loads(look.stdout)
    assert (seen["all_run"], seen["mission"]) == (look.returncode == 0, "six-robots")
    return look.returncode == 0 and seen["formation_error"] is not None


def test_several_watchers_see_the_lost_robot(tmp_path: Path) -> None:
    with running(tmp_path) as (run, flags), ExitStack() as stack:
        watchers = [
            stack.enter_context(command("watch", "six_robots", "--json", *flags, folder=tmp_path))
            for _ in range(2)
        ]
        for watcher in watchers:
            assert watcher.stdout is not None
            assert next(filter(formed, lines_of_json(watcher.stdout)))

        assert any(map(all_run_in_table, looks(*flags, folder=tmp_path)))
        assert any(map(all_run_in_json, looks("--json", *flags, folder=tmp_path)))

        for watcher in watchers:
            watcher.send_signal(signal.SIGINT)
            watcher.communicate(timeout=PATIENCE)  # it may be waiting for somebody to read what it says
            assert watcher.returncode == 0
        run.send_signal(signal.SIGINT)
        out, _ = run.communicate(timeout=60.0)
        result = json.loads(out.splitlines()[-1])
        assert result["lost"] == 0  # the real monitor has missed nothing
        assert all(child["exit"] == 0 for child in result["processes"].values())


def test_a_fleet_that_stands_is_no_fleet_that_runs(tmp_path: Path) -> None:
    with running(tmp_path) as (_, flags):
        with command("order", "six_robots", "stop", *flags, folder=tmp_path) as order:
            assert order.wait(PATIENCE) == 0
        stopped = watched("--once", "--json", *flags, folder=tmp_path)
    assert stopped.returncode == 1
    assert not json.loads(stopped.stdout)["all_run"]


@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_without_answers_it_suggests_remedies(flags: list[str], tmp_path: Path) -> None:
    end = free_endpoint()
    nobody = watched("--once", "-e", end, *flags, folder=tmp_path)
    assert nobody.returncode == 1
    assert nobody.stderr.startswith(f"six-robots: no process answers at {end}\n")
    assert "formation run six_robots" in nobody.stderr
    assert "-c FILE" in nobody.stderr
    assert not nobody.stdout or not json.loads(nobody.stdout)["all_run"]


def test_suggested_command_can_be_pasted_for_any_filename() -> None:
    options = argparse.Namespace(mission="it's mine.toml", connect=[], config=None)
    (line,) = [line for line in no_answer_message(SIX, options).splitlines() if "formation run" in line]
    assert shlex.split(line.partition("? ")[2])[-1] == options.mission


def test_watch_without_messages_says_so_and_waits(tmp_path: Path) -> None:
    with command("watch", "six_robots", "-e", free_endpoint(), folder=tmp_path) as process:
        assert process.stdout is not None
        output = [process.stdout.readline() for _ in range(2)]
        assert output[0] == "six-robots: looking for the robots …\n"
        while "no process answers" not in output[-1]:
            output.append(process.stdout.readline())
            assert output[-1], "it ended"
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
