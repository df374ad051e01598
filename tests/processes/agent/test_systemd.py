"""What systemd hears of an agent or a watchdog: it is ready, its main loop turns, it stops."""

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
from tests.processes.agent.test_agent_process import RECEIVED, Around
from tests.support.child import free_endpoint, started, until

pytestmark = pytest.mark.processes


class Systemd:
    """The other end of NOTIFY_SOCKET: what came, and when [s, monotonic]."""

    def __init__(self, path: Path) -> None:
        self.path, self.received = path, list[tuple[float, str]]()
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.settimeout(0.05)

    def listen(self, seconds: float = 0.0) -> list[str]:
        """What comes in so many seconds."""
        end, before = time.monotonic() + seconds, len(self.received)
        while time.monotonic() <= end:
            try:
                self.received.append((time.monotonic(), self.socket.recv(4096).decode()))
            except TimeoutError:
                continue
        return [text for _, text in self.received[before:]]

    def wait(self, text: str) -> None:
        until(lambda: text in self.listen(0.05))

    def beat(self, number: int) -> float:
        """How long it is between two of so many signs of life that come now [s]; nothing else may.

        In the median, for what is received late makes few of them differ.
        """
        before = len(self.received)

        def come() -> bool:
            self.listen(0.05)
            return len(self.received) >= before + number

        until(come)
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
    ids=["agent", "agent that waits for a monitor", "watchdog"],
)
def test_process_notifies_systemd_of_ready_life_and_stop(
    tmp_path: Path, systemd: Systemd, module: str, flags: list[str]
) -> None:
    around = Around(tmp_path)
    links = ["--robot", "robot2", "--robot-connect", around.robot_end]
    if module == "formation.agent":
        links += ["-l", around.agent_end]
    with started(module, str(around.file), *links, *flags) as child:
        systemd.wait("READY=1")
        assert 0.9 * MIN_REPORT_PERIOD < systemd.beat(10) < 2.0 * MIN_REPORT_PERIOD
        os.kill(child.process.pid, signal.SIGTERM)
        systemd.wait("STOPPING=1\nSTATUS=stopping: SIGTERM")
        assert child.wait() == 0


def test_hanging_main_loop_starves_systemd_watchdog(systemd: Systemd) -> None:
    end = free_endpoint()
    with started("tests.processes.agent.hanging", end) as child, Bus(BusConfig(connect=(end,))) as bus:
        child.event("ready")
        bus.advertise(ODOM, RECEIVED)
        until(lambda: bus.watched(RECEIVED))
        systemd.wait("WATCHDOG=1")
        bus.publish(RECEIVED, b"hang")
        child.event("hanging")
        systemd.listen(0.2)  # what was sent before
        assert systemd.listen(1.5) == []
        for _ in range(3):
            bus.publish(RECEIVED, b"heard all the same")
        assert child.event("received")["number"] == 4
        assert systemd.listen(0.5) == []
