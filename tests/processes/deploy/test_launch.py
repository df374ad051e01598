"""The launcher, with small scripts as its children."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from formation.deploy.local.launch import COASTING_TIME, STOP_ORDER, Child, Event, Launcher
from formation.deploy.local.plan import Part, Program
from tests.processes.deploy.stubs import DEAF, GOOD, READY, is_gone, program
from tests.support.child import PATIENCE


@pytest.fixture
def launcher(tmp_path: Path) -> Iterator[Launcher]:
    with Launcher(tmp_path) as launcher:
        yield launcher


def wait_until(launcher: Launcher, what: Callable[[], bool], seconds: float = 20.0) -> list[Event]:
    """Return the events until `what` holds; fail after `seconds`."""
    received = []
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline, f"timeout: {what}"
        event = launcher.next_event(0.05)
        if event is not None:
            received.append(event)
    return received


def test_child_becomes_ready_ends_and_reports_summary(launcher: Launcher) -> None:
    child = launcher.start(program(GOOD))
    wait_until(launcher, lambda: child.ready)
    launcher.stop()
    assert child.exit == 0
    assert not child.died
    assert child.summary == {"event": "summary", "published": {"a/odom": 3}}


def test_other_output_is_logged_without_disturbing_events(launcher: Launcher) -> None:
    garbage = """
print('hello', [1], {"event": 3}, sep="\\n")
print('{"event": 3}', "[" * 90000, sep="\\n", flush=True)
sys.stdout.buffer.write(bytes([255, 254, 10]))
"""
    child = launcher.start(program(garbage + GOOD))
    events = wait_until(launcher, lambda: child.ready)
    launcher.stop()
    assert [event.data["event"] for event in events] in ([], ["ready"])
    assert child.exit == 0
    assert b"on stdout: hello" in child.log.read_bytes()


def test_dead_child_is_distinguished_from_stopped_one(launcher: Launcher) -> None:
    dies = launcher.start(program(f"{READY}; print('no battery', file=sys.stderr); sys.exit(3)", "dies"))
    lives = launcher.start(program(GOOD, "lives"))
    wait_until(launcher, lambda: lives.ready and dies.exit is not None)
    assert dies.died
    assert dies.exit == 3
    assert dies.last_log_lines() == ["no battery"]
    assert lives.exit is None
    launcher.stop()
    assert dies.died
    assert not lives.died


def test_child_ignoring_stop_is_killed_after_grace(
    launcher: Launcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("formation.deploy.local.launch.STOP_TIMEOUTS", dict.fromkeys(STOP_ORDER, 0.3))
    child = launcher.start(program(DEAF))
    wait_until(launcher, lambda: child.ready)
    begin = time.monotonic()
    launcher.stop()
    assert child.exit == -signal.SIGKILL
    assert 0.3 <= time.monotonic() - begin < 3.0


def test_grandchild_is_killed_with_killed_child(launcher: Launcher, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.deploy.local.launch.STOP_TIMEOUTS", dict.fromkeys(STOP_ORDER, 0.1))
    code = "import subprocess; p = subprocess.Popen(['sleep', '600']); say('started', pid=p.pid);" + DEAF
    child = launcher.start(program(code))
    events = wait_until(launcher, lambda: child.ready)
    events += [event for event in [launcher.next_event(0.0)] if event]
    grandchild = next(event.data["pid"] for event in events if event.data["event"] == "started")
    launcher.stop()
    assert is_gone(grandchild, within=10.0)


def test_processes_end_in_order_agents_watchdogs_robots_monitor(
    launcher: Launcher,
) -> None:
    code = "until_told(); say('end', at=time.monotonic()); sys.exit(0)"
    names: dict[Part, str] = {
        "watch": "monitor",
        "body": "robots",
        "watchdog": "watchdog",
        "control": "agent",
    }
    children = [launcher.start(program(code, name, part)) for part, name in names.items()]
    wait_until(launcher, lambda: all(child.ready for child in children))
    ends: dict[str, float] = {}
    drain = launcher.next_event

    def keep(timeout: float) -> Event | None:
        event = drain(timeout)
        if event is not None and event.data["event"] == "end":
            ends[event.child.name] = event.data["at"]
        return event

    launcher.next_event = keep  # type: ignore[method-assign]
    launcher.stop()
    wait_until(launcher, lambda: len(ends) == len(children))
    assert ends["agent"] + COASTING_TIME <= ends["watchdog"] <= ends["robots"] <= ends["monitor"]


def test_exception_inside_launcher_context_leaves_no_child(tmp_path: Path) -> None:
    children: list[Child] = []

    def fail() -> None:
        with Launcher(tmp_path) as launcher:
            children.append(launcher.start(program(GOOD, "one")))
            children.append(launcher.start(program(GOOD, "two", "body")))
            raise RuntimeError("the launcher itself is broken")

    with pytest.raises(RuntimeError, match="itself is broken"):
        fail()
    assert all(is_gone(child.pid) for child in children)


@pytest.mark.usefixtures("in_a_terminal", "launcher")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_waiting_and_keeps_child_running(launcher: Launcher, number: int) -> None:
    child = launcher.start(program(GOOD))
    wait_until(launcher, lambda: child.ready)
    os.kill(os.getpid(), number)
    begin = time.monotonic()
    launcher.next_event(30.0)
    assert time.monotonic() - begin < 5.0
    assert launcher.interrupted
    assert child.exit is None


def test_second_signal_kills_child_that_ignores_stop(
    launcher: Launcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("formation.deploy.local.launch.SIGNAL_REPEAT_TIME", 0.0)
    child = launcher.start(program(DEAF))
    wait_until(launcher, lambda: child.ready)
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGINT)
    begin = time.monotonic()
    launcher.stop()
    assert child.exit == -signal.SIGKILL
    assert time.monotonic() - begin < 2.0


def test_signal_repeated_at_once_counts_once(launcher: Launcher, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.deploy.local.launch.SIGNAL_REPEAT_TIME", PATIENCE)
    child = launcher.start(program("until_told(); time.sleep(0.3); sys.exit(0)"))
    wait_until(launcher, lambda: child.ready)
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGINT)
    launcher.stop()
    assert child.exit == 0


def test_launcher_restores_signal_handlers(tmp_path: Path) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with Launcher(tmp_path):
        pass
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before


def test_child_runs_in_own_session(launcher: Launcher) -> None:
    child = launcher.start(program(GOOD))
    assert os.getsid(child.pid) == child.pid != os.getsid(0)


def test_missing_program_raises_error_and_adds_no_child(launcher: Launcher) -> None:
    with pytest.raises(FileNotFoundError):
        launcher.start(Program("nobody", "control", ("/no/such/program",)))
    assert launcher.children == []


def test_child_that_watches_parent_ends_with_killed_launcher(tmp_path: Path) -> None:
    code = f"""
import os, sys, time
from pathlib import Path
from formation.deploy.local.launch import Launcher
from formation.deploy.local.plan import Program
watcher = f"import os, time\\nwhile os.getppid() == {{os.getpid()}}: time.sleep(0.05)"
with Launcher(Path({str(tmp_path)!r})) as launcher:
    child = launcher.start(Program("watcher", "control", (sys.executable, "-c", watcher)))
    print(child.pid, flush=True)
    time.sleep(600)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        process.kill()
        process.wait(10.0)
    assert is_gone(child, within=10.0)
