"""Notifications of agent and watchdog to systemd: ready, main loop running, stopping."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Self

import pytest

from formation.topics import ODOM
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import MIN_REPORT_PERIOD
from tests.processes.agent.test_agent_process import ODOM_KEY, Scene
from tests.support.child import Child, free_endpoint, started, until

pytestmark = pytest.mark.processes


class Systemd:
    """The receiving end of NOTIFY_SOCKET: every message with its time [s, monotonic]."""

    def __init__(self, path: Path) -> None:
        self.path, self.received = path, list[tuple[float, str]]()
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self._receiver = threading.Thread(target=self._receive)
        self._receiver.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.shutdown(socket.SHUT_RDWR)
        self._receiver.join()
        self.socket.close()

    def listen(self, seconds: float) -> list[str]:
        """Return the messages that arrive within `seconds`."""
        before = len(self.received)
        time.sleep(seconds)
        return [text for _, text in self.received[before:]]

    def catch_up(self) -> None:
        """Wait until every message that was sent before has been received: a queue keeps their order."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"MARK=1", str(self.path))
        self.wait("MARK=1")

    def wait(self, text: str) -> None:
        until(lambda: text in [received for _, received in self.received])

    def watchdog_period(self, number: int) -> float:
        """Return the median period of `number` messages after READY=1 [s], which must all be WATCHDOG=1.

        The median, because late reception changes few of the periods.
        """
        self.wait("READY=1")
        start = [text for _, text in self.received].index("READY=1") + 1
        until(lambda: len(self.received) >= start + number)
        beats = self.received[start : start + number]
        assert {text for _, text in beats} == {"WATCHDOG=1"}
        return median(later - earlier for (earlier, _), (later, _) in pairwise(beats))

    def _receive(self) -> None:
        while text := self.socket.recv(4096).decode():
            self.received.append((time.monotonic(), text))


def test_processes_notify_systemd_of_ready_watchdog_and_stopping(
    tmp_path: Path, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, running = Scene(tmp_path), dict[str, tuple[Systemd, Child]]()
    own = (str(scene.file), "--robot", "robot2", "--robot-connect", scene.robot_end)
    for name, words in {
        "agent": ("formation.agent", *own, "-l", free_endpoint()),
        "agent awaiting monitor": ("formation.agent", *own, "-l", free_endpoint(), "--await-monitor", "60"),
        "watchdog": ("formation.agent.watchdog", *own),
    }.items():
        systemd = stack.enter_context(Systemd(tmp_path / name))
        monkeypatch.setenv("NOTIFY_SOCKET", str(systemd.path))
        running[name] = systemd, stack.enter_context(started(*words))
    for name, (systemd, child) in running.items():
        assert 0.9 * MIN_REPORT_PERIOD < systemd.watchdog_period(10) < 2.0 * MIN_REPORT_PERIOD, name
        os.kill(child.pid, signal.SIGTERM)
        systemd.wait("STOPPING=1\nSTATUS=stopping: SIGTERM")
        assert child.wait() == 0


def test_hanging_main_loop_sends_no_watchdog_notification(
    tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with (
        Systemd(tmp_path / "notify") as systemd,
        started("tests.processes.agent.hanging", endpoint) as child,
        Bus(BusConfig(connect=(endpoint,))) as bus,
    ):
        child.event("ready")
        bus.advertise(ODOM, ODOM_KEY)
        until(lambda: bus.watched(ODOM_KEY))
        systemd.wait("WATCHDOG=1")
        bus.publish(ODOM_KEY, b"hang")
        child.event("hanging")
        systemd.catch_up()
        assert systemd.listen(1.5) == []
        for _ in range(3):
            bus.publish(ODOM_KEY, b"heard all the same")
        assert child.event("received")["number"] == 4
        assert systemd.listen(0.5) == []
