"""Leader and simulated robots as processes: how they end, and how they refuse bad input."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from tests.processes.agent.leader_and_robot import leader
from tests.support.child import free_endpoint, started

pytestmark = pytest.mark.processes


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("module", ["formation.leader", "formation.agent.simulated"])
def test_signal_ends_process_with_summary_and_exit_0(module: str, number: signal.Signals) -> None:
    with started(module, "six_robots", "-l", free_endpoint()) as child:
        child.event("ready")
        took = child.signal(number)
        summary = child.event("summary")
        assert child.wait() == 0
    assert took < 5.0
    assert summary["process"] in {"leader robot1", "robots"}
    assert summary["dropped"] == {"overflowed": 0}
    assert number.name in child.errors


@pytest.mark.parametrize("module", ["formation.leader", "formation.agent.simulated"])
@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["no_such_mission"], "no such file, and no shipped mission of that name"),
        (["six_robots", "-l", "tcp/nowhere"], "must be PROTOCOL/HOST:PORT"),
        (["six_robots", "--cfg", "lease"], "must be PATH:VALUE"),
    ],
)
def test_bad_input_prints_one_line_and_exits_2(module: str, arguments: list[str], why: str) -> None:
    with started(module, *arguments) as child:
        assert child.wait() == 2
        assert child.errors.count("\n") == 1
        assert why in child.errors


def test_endpoint_in_use_is_named_in_error() -> None:
    end = free_endpoint()
    with leader(end), started("formation.leader", "six_robots", "-l", end) as second:
        assert second.wait() == 2
        assert second.errors == (
            f"leader: cannot listen on {end}: the address is in use;"
            " is there a second leader robot1 on this machine?\n"
        )


@pytest.mark.parametrize("module", ["formation.leader", "formation.agent.simulated"])
def test_process_ends_when_parent_is_killed(module: str) -> None:
    parent = (
        "import os, subprocess, sys, time\n"
        f"argv = [sys.executable, '-m', '{module}', 'six_robots', '-l', '{free_endpoint()}']\n"
        "subprocess.Popen([*argv, '--parent', str(os.getpid())], stderr=subprocess.DEVNULL)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as between:
        assert between.stdout is not None
        assert '"ready"' in between.stdout.readline()
        between.kill()
        killed = time.monotonic()
        rest = between.stdout.read()  # returns when the pipe is closed: the child has ended, too
    assert '"summary"' in rest
    assert time.monotonic() - killed < 5.0
