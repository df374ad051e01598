"""Notifications of agent and watchdog to systemd: ready, main loop running, stopping."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from formation.topics import ODOM
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import MIN_REPORT_PERIOD
from tests.processes.agent.test_agent_process import ODOM_KEY, Scene
from tests.support.child import free_endpoint, started, until

pytestmark = pytest.mark.processes


class Systemd:
    """The receiving end of NOTIFY_SOCKET: every message with its time [s, monotonic]."""

    def __init__(self, path: Path) -> None:
        self.path, self.received = path, list[tuple[float, str]]()
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.settimeout(0.05)

    def listen(self, seconds: float = 0.0) -> list[str]:
        """Return the messages that arrive within `seconds`."""
        end, before = time.monotonic() + seconds, len(self.received)
        while time.monotonic() <= end:
            try:
                self.received.append((time.monotonic(), self.socket.recv(4096).decode()))
            except TimeoutError:
                continue
        return [text for _, text in self.received[before:]]

    def wait(self, text: str) -> None:
        until(lambda: text in self.listen(0.05))

    def watchdog_period(self, number: int) -> float:
        """Return the median period of the next `number` messages [s], which must all be WATCHDOG=1.

        The median, because late reception changes few of the periods.
        """
        before = len(self.received)

        def received_enough() -> bool:
            self.listen(0.05)
            return len(self.received) >= before + number

        until(received_enough)
        beats = self.received[before:]
        assert {text for _, text in beats} == {"WATCHDOG=1"}
        return median(later - earlier for (earlier, _), (later, _) in pairwise(beats))


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Systemd]:
    one = Systemd(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", str(one.path))
    yield one
    one.socket.close()


@pytest.mark.parametrize(
    ("module", "flags"),
    [
        ("formation.agent", []),
        ("formation.agent", ["--await-monitor", "60"]),
        ("formation.agent.watchdog", []),
    ],
    ids=["agent", "agent awaiting monitor", "watchdog"],
)
def test_process_notifies_systemd_of_ready_watchdog_and_stopping(
    tmp_path: Path, systemd: Systemd, module: str, flags: list[str]
) -> None:
    scene = Scene(tmp_path)
    links = ["--robot", "robot2", "--robot-connect", scene.robot_end]
    if module == "formation.agent":
        links += ["-l", scene.agent_end]
    with started(module, str(scene.file), *links, *flags) as child:
        systemd.wait("READY=1")
        assert 0.9 * MIN_REPORT_PERIOD < systemd.watchdog_period(10) < 2.0 * MIN_REPORT_PERIOD
        os.kill(child.process.pid, signal.SIGTERM)
        systemd.wait("STOPPING=1\nSTATUS=stopping: SIGTERM")
        assert child.wait() == 0


def test_hanging_main_loop_sends_no_watchdog_notification(systemd: Systemd) -> None:
    end = free_endpoint()
    with started("tests.processes.agent.hanging", end) as child, Bus(BusConfig(connect=(end,))) as bus:
        child.event("ready")
        bus.advertise(ODOM, ODOM_KEY)
        until(lambda: bus.watched(ODOM_KEY))
        systemd.wait("WATCHDOG=1")
        bus.publish(ODOM_KEY, b"hang")
        child.event("hanging")
        systemd.listen(0.2)  # discard what was sent before
        assert systemd.listen(1.5) == []
        for _ in range(3):
            bus.publish(ODOM_KEY, b"heard all the same")
        assert child.event("received")["number"] == 4
        assert systemd.listen(0.5) == []
