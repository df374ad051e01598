"""Notifications to systemd through a real datagram socket."""

from __future__ import annotations

import logging
import secrets
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from formation.transport.runtime.process import MIN_REPORT_PERIOD, Notifier


@pytest.fixture(params=["file", "abstract name"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """Open a socket that listens as systemd's does; yield it and the value of NOTIFY_SOCKET."""
    name = str(tmp_path / "notify") if request.param == "file" else f"@formation/{secrets.token_hex(8)}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(name.replace("@", "\0"))
        one.setblocking(False)
        yield one, name


def received(systemd: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(systemd.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_notifier_sends_ready_periodic_watchdog_and_stopping(
    systemd: tuple[socket.socket, str],
) -> None:
    one, name = systemd
    notifier = Notifier({"NOTIFY_SOCKET": name})
    notifier.ready()
    assert received(one) == ["READY=1"]
    for now in (
        10.0,
        10.0 + MIN_REPORT_PERIOD / 2,
        10.0 + MIN_REPORT_PERIOD * 0.99,
        10.0 + MIN_REPORT_PERIOD,
        10.0 + MIN_REPORT_PERIOD * 1.5,
    ):
        notifier.alive(now)
    assert received(one) == ["WATCHDOG=1", "WATCHDOG=1"]
    notifier.stopping("SIGTERM")
    notifier.alive(20.0)
    notifier.stopping("again")
    assert received(one) == ["STOPPING=1\nSTATUS=stopping: SIGTERM"]


def test_multiline_reason_is_sent_as_one_line(systemd: tuple[socket.socket, str]) -> None:
    one, name = systemd
    Notifier({"NOTIFY_SOCKET": name}).stopping("failed\nREADY=1")
    assert received(one) == ["STOPPING=1\nSTATUS=stopping: failed READY=1"]


def test_notifier_without_notify_socket_opens_no_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(*_: object) -> None:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket, "socket", opened)
    notifier = Notifier({})
    notifier.ready()
    notifier.alive(1.0)
    notifier.stopping("SIGINT")


def test_absent_supervisor_blocks_nothing_and_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")})
    with caplog.at_level(logging.WARNING):
        notifier.ready()
        notifier.stopping("SIGTERM")
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == [
        "systemd was not told READY=1"
    ]


def test_unread_supervisor_socket_blocks_nothing_and_logs_once(
    systemd: tuple[socket.socket, str], caplog: pytest.LogCaptureFixture
) -> None:
    _, name = systemd
    notifier = Notifier({"NOTIFY_SOCKET": name})
    for turn in range(2000):
        notifier.alive(turn * 1.0)
    notifier.stopping("SIGTERM")
    assert len(caplog.records) == 1
