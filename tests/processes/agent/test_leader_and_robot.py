"""Leader and simulated robots as processes: how they end with their parent, and how they refuse bad input."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence

import pytest

from formation.agent.simulated.__main__ import main as robot_main
from formation.leader.__main__ import main as leader_main
from formation.transport.bus import Bus, BusConfig
from tests.support.child import free_endpoint

pytestmark = pytest.mark.processes
Main = Callable[[Sequence[str]], int]
MODULES = ("formation.leader", "formation.agent.simulated")


@pytest.mark.parametrize("main", [leader_main, robot_main])
@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["no_such_mission"], "no such file, and no shipped mission of that name"),
        (["six_robots", "-l", "tcp/nowhere"], "must be PROTOCOL/HOST:PORT"),
        (["six_robots", "--cfg", "lease"], "must be PATH:VALUE"),
    ],
)
def test_bad_input_prints_one_line_and_exits_2(
    main: Main, arguments: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert why in printed.err


def test_endpoint_in_use_is_named_in_error(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with Bus(BusConfig(listen=(endpoint,))):
        assert leader_main(["six_robots", "-l", endpoint]) == 2
    assert capsys.readouterr().err == (
        f"leader: cannot listen on {endpoint}: the address is in use;"
        " is there a second leader robot1 on this machine?\n"
    )


def test_processes_end_when_parent_is_killed() -> None:
    commands = [["-m", module, "six_robots", "-l", free_endpoint()] for module in MODULES]
    parent = (
        "import os, subprocess, sys, time\n"
        f"for words in {commands}:\n"
        "    argv = [sys.executable, *words, '--parent', str(os.getpid())]\n"
        "    subprocess.Popen(argv, stderr=subprocess.DEVNULL)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as between:
        assert between.stdout is not None
        assert all('"ready"' in between.stdout.readline() for _ in commands)
        between.kill()
        killed = time.monotonic()
        rest = between.stdout.read()  # returns when the pipe is closed: the children have ended, too
    assert rest.count('"summary"') == len(commands)
    assert time.monotonic() - killed < 5.0
