"""What systemd hears, through a real datagram socket."""

from __future__ import annotations

import logging
import secrets
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from formation.transport.notify import PERIOD, Notifier


@pytest.fixture(params=["a file", "an abstract name"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """A socket that listens as systemd's does, and what NOTIFY_SOCKET says."""
    name = str(tmp_path / "notify") if request.param == "a file" else f"@formation/{secrets.token_hex(8)}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(name.replace("@", "\0"))
        one.setblocking(False)
        yield one, name


def heard(systemd: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(systemd.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_it_is_told_of_the_start_of_every_turn_that_counts_and_of_the_end(
    systemd: tuple[socket.socket, str],
) -> None:
    one, name = systemd
    notifier = Notifier({"NOTIFY_SOCKET": name})
    notifier.ready()
    assert heard(one) == ["READY=1"]
    for now in (10.0, 10.0 + PERIOD / 2, 10.0 + PERIOD * 0.99, 10.0 + PERIOD, 10.0 + PERIOD * 1.5):
        notifier.alive(now)
    assert heard(one) == ["WATCHDOG=1", "WATCHDOG=1"]
    notifier.stopping("SIGTERM")
    notifier.alive(20.0)
    notifier.stopping("again")
    assert heard(one) == ["STOPPING=1\nSTATUS=stopping: SIGTERM"]


def test_a_reason_of_several_lines_is_one_assignment(systemd: tuple[socket.socket, str]) -> None:
    one, name = systemd
    Notifier({"NOTIFY_SOCKET": name}).stopping("failed\nREADY=1")
    assert heard(one) == ["STOPPING=1\nSTATUS=stopping: failed READY=1"]


def test_without_the_variable_nothing_is_opened_or_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(*_: object) -> None:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket, "socket", opened)
    notifier = Notifier({})
    notifier.ready()
    notifier.alive(1.0)
    notifier.stopping("SIGINT")


def test_a_supervisor_that_does_not_listen_holds_up_nothing_and_is_named_in_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")})
    with caplog.at_level(logging.WARNING):
        notifier.ready()
        notifier.stopping("SIGTERM")
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == [
        "systemd was not told READY=1"
    ]


def test_a_supervisor_that_does_not_read_holds_up_nothing_and_is_named_once(
    systemd: tuple[socket.socket, str], caplog: pytest.LogCaptureFixture
) -> None:
    _, name = systemd
    notifier = Notifier({"NOTIFY_SOCKET": name})
    for turn in range(2000):
        notifier.alive(turn * 1.0)
    notifier.stopping("SIGTERM")
    assert len(caplog.records) == 1
