"""`formation watch` as a process: several beside a run and its monitor, and one without a run."""

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

from formation.deploy.cli import main
from formation.deploy.links import no_answer_message
from formation.mission.file import load
from tests.support.child import PATIENCE, free_endpoint
from tests.support.launched import command

pytestmark = pytest.mark.processes
PAIR = load("turtlebot3_pair")


@contextmanager
def running(folder: Path) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """Start a run of two robots; yield its process, and flags with its endpoints, which may be unusual."""
    arguments = ("run", "turtlebot3_pair", "--duration", "300", "--no-page", "--json", "--record", "run.mcap")
    with command(*arguments, folder=folder) as process:
        assert process.stderr is not None
        flags: list[str] = []
        for line in process.stderr:
            if "formation stop" in line:
                flags = re.findall(r"-e|tcp/\S+", line)
            if "2 run" in line:
                yield process, flags
                return
    raise AssertionError("the robots did not reach run")


def watched(*flags: str, folder: Path, mission: str = "turtlebot3_pair") -> subprocess.CompletedProcess[str]:
    with command("watch", mission, *flags, folder=folder) as process:
        out, err = process.communicate(timeout=PATIENCE)
    return subprocess.CompletedProcess([], process.returncode, out, err)


def lines_of_json(stream: IO[str]) -> Iterator[dict[str, Any]]:
    for line in stream:
        yield json.loads(line)


def formed(seen: dict[str, Any]) -> bool:
    """Whether all robots run and are near their slots: until then a late robot is unavailable."""
    error = seen["formation_error"]
    return bool(seen["all_run"]) and error is not None and error < 0.04


def snapshots(*flags: str, folder: Path) -> Iterator[subprocess.CompletedProcess[str]]:
    """Results of `formation watch --once`, one after another.

    In some of them a robot may hold because a busy machine delayed its messages.
    """
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        yield watched("--once", *flags, folder=folder)
    raise AssertionError("not all robots ran in one snapshot")


def all_run_in_table(look: subprocess.CompletedProcess[str]) -> bool:
    """Whether all robots run, by the table; check that the exit code agrees."""
    title, _, *rest = look.stdout.splitlines()
    rows = [line.split() for line in rest[: len(PAIR.names)]]
    assert (title, [row[0] for row in rows]) == ("turtlebot3-pair, field law", list(PAIR.names)), look.stderr
    states = {row[1] if row[1] != "(leader)" else row[2] for row in rows}
    assert look.returncode in ({1} if "hold" in states else {0, 1})
    return look.returncode == 0 and states == {"run"}


def all_run_in_json(look: subprocess.CompletedProcess[str]) -> bool:
    """Whether all robots run, by the JSON output; check that the exit code agrees."""
    seen = json.loads(look.stdout)
    assert (seen["all_run"], seen["mission"]) == (look.returncode == 0, "turtlebot3-pair")
    return look.returncode == 0 and seen["formation_error"] is not None


def test_watchers_show_run_and_its_stop_and_lose_no_message(tmp_path: Path) -> None:
    with running(tmp_path) as (run, flags), ExitStack() as stack:
        watchers = [
            stack.enter_context(command("watch", "turtlebot3_pair", "--json", *flags, folder=tmp_path))
            for _ in range(2)
        ]
        for watcher in watchers:
            assert watcher.stdout is not None
            assert next(filter(formed, lines_of_json(watcher.stdout)))

        assert any(map(all_run_in_table, snapshots(*flags, folder=tmp_path)))
        assert any(map(all_run_in_json, snapshots("--json", *flags, folder=tmp_path)))

        for watcher in watchers:
            watcher.send_signal(signal.SIGINT)
            watcher.communicate(timeout=PATIENCE)  # it may block until its output is read
            assert watcher.returncode == 0
        _check_stopped(tmp_path, flags)
        run.send_signal(signal.SIGINT)
        out, _ = run.communicate(timeout=60.0)
        result = json.loads(out.splitlines()[-1])
        assert result["lost"] == 0  # the monitor of the run has missed no message
        assert all(child["exit"] == 0 for child in result["processes"].values())


def _check_stopped(folder: Path, flags: list[str]) -> None:
    """Check that `watch --once` exits with 1 for a fleet that is stopped, and for another mission."""
    with command("order", "turtlebot3_pair", "stop", *flags, folder=folder) as order:
        assert order.wait(PATIENCE) == 0
    stopped = watched("--once", "--json", *flags, folder=folder)
    assert stopped.returncode == 1
    assert not json.loads(stopped.stdout)["all_run"]
    assert json.loads(stopped.stdout)["other_mission"] == []
    other = watched("--once", "--json", *flags, folder=folder, mission="convoy")
    assert (other.returncode, json.loads(other.stdout)["other_mission"]) == (1, list(PAIR.names))
    assert "leader, robot1, robot2 run another mission than convoy" in other.stderr


@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_watch_without_answers_suggests_remedies(
    flags: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reported: list[str] = []

    @contextmanager
    def recorded(what: str) -> Iterator[None]:
        reported.append(what)
        yield

    monkeypatch.setattr("formation.deploy.watch.message_if_slow", recorded)
    monkeypatch.setattr("formation.deploy.watch.COMPLETE_TIMEOUT_SECONDS", 0.1)
    end = free_endpoint()
    assert main(["watch", "turtlebot3_pair", "--once", "-e", end, *flags]) == 1
    out, err = capsys.readouterr()
    assert err.startswith(f"turtlebot3-pair: no process answers at {end}\n")
    assert "formation run turtlebot3_pair" in err
    assert "-c FILE" in err
    assert not out or not json.loads(out)["all_run"]
    assert reported == ["looking for the robots, 0.1 s at most"]


def test_suggested_command_quotes_mission_filename() -> None:
    options = argparse.Namespace(mission="it's mine.toml", connect=[], config=None)
    (line,) = [
        line for line in no_answer_message(PAIR, options, "monitor").splitlines() if "formation run" in line
    ]
    assert shlex.split(line.partition(": ")[2])[-1] == options.mission


def test_watch_without_messages_reports_it_and_waits(tmp_path: Path) -> None:
    with command("watch", "turtlebot3_pair", "-e", free_endpoint(), folder=tmp_path) as process:
        assert process.stdout is not None
        output = [process.stdout.readline() for _ in range(2)]
        assert output[0] == "turtlebot3-pair: looking for the robots …\n"
        while "no process answers" not in output[-1]:
            output.append(process.stdout.readline())
            assert output[-1], "the watch ended"
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
